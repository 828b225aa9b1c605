"""What the tracker package raises; each text says what was wrong and how to mend it."""


class MscfError(Exception):
    """Everything this package raises on purpose."""


class ConfigError(MscfError, ValueError):
    """A configuration value is unknown or outside its range."""


class TrackerNotInitialisedError(MscfError, RuntimeError):
    """`Tracker.update` was called before `Tracker.init`."""


class FrameError(MscfError, ValueError):
    """A frame has the wrong type, shape or size."""


class BoxError(MscfError, ValueError):
    """A box is empty, too small, not finite, or outside the frame."""


class SourceError(MscfError):
    """A source of frames cannot be opened, or a frame of it cannot be decoded."""


class OutputError(MscfError):
    """A file that was asked for cannot be written."""
