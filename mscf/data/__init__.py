"""The data files of the package, and the development scripts that make and measure them (`README.md`)."""
