"""What the application raises; each text says what was wrong and how to mend it."""


class CompanionError(Exception):
    """Everything this package raises on purpose."""


class ConfigError(CompanionError, ValueError):
    """The configuration cannot be read, or a value in it is unknown or out of range (exit status 78)."""


class UsageError(CompanionError, ValueError):
    """The command line asks for something that does not exist (exit status 2)."""


class CameraLostError(CompanionError):
    """The camera is not there, or delivers no frames any more; it is tried again."""


class LinkLostError(CompanionError):
    """The port to the autopilot cannot be opened, or broke; it is tried again."""


class IllegalTransitionError(CompanionError, RuntimeError):
    """The controller asked for a transition that no mode has: a mistake of this code."""
