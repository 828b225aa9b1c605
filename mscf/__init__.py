"""MSCF, the mutation sensitive correlation filter: a box tracker for drones (ICRA 2021)."""

from mscf.config import PRESETS, TrackerConfig
from mscf.errors import BoxError, ConfigError, FrameError, MscfError, TrackerNotInitialisedError
from mscf.geometry import Box
from mscf.long_term import Expected, LongTermPolicy, LongTermResult, LongTermTracker, TrackStatus
from mscf.tracker import Snapshot, Tracker, TrackResult

__all__ = [
    "PRESETS",
    "Box",
    "BoxError",
    "ConfigError",
    "Expected",
    "FrameError",
    "LongTermPolicy",
    "LongTermResult",
    "LongTermTracker",
    "MscfError",
    "Snapshot",
    "TrackResult",
    "TrackStatus",
    "Tracker",
    "TrackerConfig",
    "TrackerNotInitialisedError",
]
