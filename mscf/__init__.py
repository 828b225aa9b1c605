"""MSCF, the mutation sensitive correlation filter: a box tracker for drones (ICRA 2021)."""

from mscf.config import PRESETS, TrackerConfig
from mscf.errors import BoxError, ConfigError, FrameError, MscfError, TrackerNotInitialisedError
from mscf.geometry import Box
from mscf.tracker import Tracker, TrackResult

__all__ = [
    "PRESETS",
    "Box",
    "BoxError",
    "ConfigError",
    "FrameError",
    "MscfError",
    "TrackResult",
    "Tracker",
    "TrackerConfig",
    "TrackerNotInitialisedError",
]
