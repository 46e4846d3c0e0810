"""Monte-Carlo studies: the same draws for every method, results with intervals, on any number of cores and machines."""

from trackrs.study._metrics import Cardinality, Identity, LeadError, Metric, PositionError
from trackrs.study._result import Band, Column, Failure, MethodResult, StudyResult
from trackrs.study._shards import Part
from trackrs.study._statistics import Difference, Summary
from trackrs.study._study import Chunk, Draw, Scenario, Study

__all__ = [
    "Band",
    "Cardinality",
    "Chunk",
    "Column",
    "Difference",
    "Draw",
    "Failure",
    "Identity",
    "LeadError",
    "MethodResult",
    "Metric",
    "Part",
    "PositionError",
    "Scenario",
    "Study",
    "StudyResult",
    "Summary",
]
