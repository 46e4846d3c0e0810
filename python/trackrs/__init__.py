"""trackrs: from raw sensor reports to tracks with honest covariances."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from trackrs._trackrs import __version__

if TYPE_CHECKING:
    from trackrs import association, geodesy, live, report, rotation, scenarios, study
    from trackrs.adaptive import ChiSquareScreen, LimitedMemoryNoise, NisScaledNoise, ResidualNoise
    from trackrs.association import (
        JIPDA,
        JPDA,
        NPDA,
        PDA,
        Assignment,
        GlobalNearestNeighbour,
        NearestNeighbour,
        assign,
    )
    from trackrs.batch import BatchRun, TrackBatch
    from trackrs.errors import (
        BusyError,
        DimensionError,
        InternalError,
        NonFiniteError,
        NotPositiveDefiniteError,
        ParameterError,
        StateError,
        StrictError,
        TimeError,
        TrackrsError,
        UnknownSensorError,
        UnobservableError,
    )
    from trackrs.evaluation import Evaluation, TargetScore, Truth, evaluate
    from trackrs.filter import CubatureKalmanFilter, ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
    from trackrs.fusion import covariance_intersection
    from trackrs.gating import Gate, GatedPairs, squared_distances
    from trackrs.intensity import AdaptiveBirth, Birth, DetectionRate, Extent, Mixture, Spawn
    from trackrs.late import DropLate, Reorder, Replay
    from trackrs.lead import JerkChoice, LeadCurve, PsdFit, choose_jerk_psd, fit_psd, lead_curve
    from trackrs.lof import LocalOutlierFactor, OutlierFactors
    from trackrs.metric import (
        GOSPA,
        OSPA,
        GospaDistance,
        OspaDistance,
        Pair,
        gospa,
        nees,
        nis,
        ospa,
        rmse,
        whiteness,
    )
    from trackrs.motion import ConstantAcceleration, ConstantVelocity, CustomMotion, LinearMotion, RandomWalk, Singer
    from trackrs.partition import (
        DbscanPartition,
        DecisionGraph,
        DensityPeakPartition,
        DistancePartition,
        KMeansPartition,
        Partitions,
        TwoLevelPartition,
        TwoLevels,
    )
    from trackrs.phd import CPHD, GMPHD, ExtendedGMPHD, IntensityTracker
    from trackrs.pose import CameraSensor, PoseFix, PoseSensor
    from trackrs.range_array import RangeArray
    from trackrs.runs import ChiSquareTests, FilterRun, SmoothedRun, Verdict, Whiteness
    from trackrs.sensor import CustomSensor, LinearSensor, PositionSensor, RangeBearing
    from trackrs.start import start_state
    from trackrs.study import Study
    from trackrs.timing import RegularTimes, regularise
    from trackrs.tracker import ClutterMap, Deletion, Existence, MofN, MultiTargetTracker
    from trackrs.tree import ClusterTree, TreePartition
    from trackrs.types import Event, Fix, GaussianState, Health, Ledger, Scan, Track, Tracks, Update

__all__ = [
    "CPHD",
    "GMPHD",
    "GOSPA",
    "JIPDA",
    "JPDA",
    "NPDA",
    "OSPA",
    "PDA",
    "AdaptiveBirth",
    "Assignment",
    "BatchRun",
    "Birth",
    "BusyError",
    "CameraSensor",
    "ChiSquareScreen",
    "ChiSquareTests",
    "ClusterTree",
    "ClutterMap",
    "ConstantAcceleration",
    "ConstantVelocity",
    "CubatureKalmanFilter",
    "CustomMotion",
    "CustomSensor",
    "DbscanPartition",
    "DecisionGraph",
    "Deletion",
    "DensityPeakPartition",
    "DetectionRate",
    "DimensionError",
    "DistancePartition",
    "DropLate",
    "Evaluation",
    "Event",
    "Existence",
    "ExtendedGMPHD",
    "ExtendedKalmanFilter",
    "Extent",
    "FilterRun",
    "Fix",
    "Gate",
    "GatedPairs",
    "GaussianState",
    "GlobalNearestNeighbour",
    "GospaDistance",
    "Health",
    "IntensityTracker",
    "InternalError",
    "JerkChoice",
    "KMeansPartition",
    "KalmanFilter",
    "LeadCurve",
    "Ledger",
    "LimitedMemoryNoise",
    "LinearMotion",
    "LinearSensor",
    "LocalOutlierFactor",
    "Mixture",
    "MofN",
    "MultiTargetTracker",
    "NearestNeighbour",
    "NisScaledNoise",
    "NonFiniteError",
    "NotPositiveDefiniteError",
    "OspaDistance",
    "OutlierFactors",
    "Pair",
    "ParameterError",
    "Partitions",
    "PoseFix",
    "PoseSensor",
    "PositionSensor",
    "PsdFit",
    "RandomWalk",
    "RangeArray",
    "RangeBearing",
    "RegularTimes",
    "Reorder",
    "Replay",
    "ResidualNoise",
    "Scan",
    "Singer",
    "SmoothedRun",
    "Spawn",
    "StateError",
    "StrictError",
    "Study",
    "TargetScore",
    "TimeError",
    "Track",
    "TrackBatch",
    "TrackrsError",
    "Tracks",
    "TreePartition",
    "Truth",
    "TwoLevelPartition",
    "TwoLevels",
    "UnknownSensorError",
    "UnobservableError",
    "UnscentedKalmanFilter",
    "Update",
    "Verdict",
    "Whiteness",
    "__version__",
    "assign",
    "association",
    "choose_jerk_psd",
    "covariance_intersection",
    "evaluate",
    "fit_psd",
    "geodesy",
    "gospa",
    "lead_curve",
    "live",
    "nees",
    "nis",
    "ospa",
    "regularise",
    "report",
    "rmse",
    "rotation",
    "scenarios",
    "squared_distances",
    "start_state",
    "study",
    "whiteness",
]

_MODULES = ("association", "geodesy", "live", "report", "rotation", "scenarios", "study")

# Names are looked up when they are first used: making all the dataclasses takes half as long as importing NumPy.
_HOMES = (
    "adaptive",
    "association",
    "batch",
    "errors",
    "evaluation",
    "filter",
    "fusion",
    "gating",
    "intensity",
    "late",
    "lead",
    "lof",
    "metric",
    "motion",
    "partition",
    "phd",
    "pose",
    "range_array",
    "runs",
    "sensor",
    "start",
    "study",
    "timing",
    "tracker",
    "tree",
    "types",
)


def __getattr__(name: str) -> object:
    """Find a public name in its module and keep it."""
    if name in _MODULES:
        return import_module(f"trackrs.{name}")
    if name in __all__:
        for home in _HOMES:
            module = import_module(f"trackrs.{home}")
            if name in vars(module):
                return globals().setdefault(name, vars(module)[name])
    msg = f"module 'trackrs' has no attribute {name!r}"
    raise AttributeError(msg)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
