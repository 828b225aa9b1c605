"""Feature channels of a patch: gray, FHOG and colour names."""
