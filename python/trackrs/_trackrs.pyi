# The compiled module. Private: `trackrs` wraps all of it.
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from trackrs.types import Scan

_Array: TypeAlias = NDArray[np.float64]

__all__ = [
    "Filter",
    "LocalFrame",
    "Motion",
    "Sensor",
    "Tracker",
    "Underwater",
    "__version__",
    "apply_similarity",
    "assign",
    "chi_square_quantile",
    "covariance_intersection",
    "cumulative",
    "ecef_to_geodetic",
    "evaluate",
    "fit_similarity",
    "geodetic_to_ecef",
    "gospa",
    "nees",
    "nis",
    "ospa",
    "paper_start",
    "place_array",
    "reference_course",
    "reference_hydrophones",
    "smooth",
    "start_state",
    "whiteness",
]

__version__: str

@final
class Motion:
    @staticmethod
    def random_walk(values: Sequence[float], psd: bool) -> Motion: ...
    @staticmethod
    def constant_velocity(values: Sequence[float], psd: bool) -> Motion: ...
    @staticmethod
    def constant_acceleration(values: Sequence[float], psd: bool) -> Motion: ...
    @staticmethod
    def linear(transition: _Array, noise: _Array) -> Motion: ...
    @property
    def state_dim(self) -> int: ...
    @property
    def labels(self) -> list[str]: ...
    def transition(self, dt: float) -> _Array: ...
    def noise(self, dt: float) -> _Array: ...

@final
class Sensor:
    @staticmethod
    def position(std: Sequence[float]) -> Sensor: ...
    @staticmethod
    def range_bearing(position: tuple[float, float], range_std: float, bearing_std: float) -> Sensor: ...
    @staticmethod
    def range_array(
        hydrophones: _Array,
        range_std: Sequence[float],
        depth_std: float | None = None,
        speeds: Sequence[float] | None = None,
        profile: tuple[Sequence[float], Sequence[float]] | None = None,
        side: str | None = None,
        preset: str | None = None,
        survey_std: Sequence[float] | None = None,
        bias: tuple[Sequence[float], float] | None = None,
        scale: tuple[float, float] | None = None,
    ) -> Sensor: ...
    @staticmethod
    def stack(arrays: Sequence[Sensor]) -> dict[str, Any]: ...
    def fix(self, value: _Array, side: str | None = None) -> dict[str, Any]: ...
    @staticmethod
    def linear(matrix: _Array, noise: _Array, offset: _Array) -> Sensor: ...
    @property
    def measurement_dim(self) -> int: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def extra_labels(self) -> list[str]: ...
    def noise(self) -> _Array: ...
    def observe(self, state: _Array, platform: _Array | None = None) -> _Array: ...

@final
class Filter:
    @staticmethod
    def kalman(motion: Motion, sensor: Sensor) -> Filter: ...
    @staticmethod
    def extended(motion: Motion, sensor: Sensor, iterations: int) -> Filter: ...
    def with_second_order(self) -> Filter: ...
    def with_screen(self, alpha: float, mode: str, restart: bool, allowance: float | None = None) -> Filter: ...
    def with_adaptation(
        self,
        window: int,
        r_window: int | None,
        method: str,
        forms: tuple[str, str],
        first_epoch: int,
        q_limits: tuple[float, float],
        r_limits: tuple[float, float],
    ) -> Filter: ...
    @property
    def starts(self) -> bool: ...
    def predict(self, mean: _Array, cov: _Array, dt: float, known: _Array | None = None) -> tuple[_Array, _Array]: ...
    def update(self, mean: _Array, cov: _Array, value: _Array, platform: _Array | None = None) -> dict[str, Any]: ...
    def run(
        self,
        times: _Array,
        values: _Array,
        initial: tuple[float, _Array, _Array] | None,
        history: str,
        inputs: _Array | None = None,
    ) -> dict[str, Any]: ...

@final
class Tracker:
    def __new__(
        cls,
        motion: Motion,
        sensors: Mapping[str, Sensor],
        settings: Mapping[str, Any],
        initial: Sequence[tuple[float, _Array, _Array]],
    ) -> Tracker: ...
    @staticmethod
    def from_bytes(data: bytes) -> Tracker: ...
    def to_bytes(self) -> bytes: ...
    def step(self, scan: Scan) -> dict[str, Any]: ...
    def run(self, scans: Sequence[Scan]) -> dict[str, Any]: ...
    def labels(self) -> list[str]: ...
    def events(self) -> list[dict[str, Any]]: ...
    def event_counts(self) -> dict[str, int]: ...
    def ledger(self) -> dict[str, Any]: ...

def smooth(
    means: _Array,
    covs: _Array,
    predicted_means: _Array,
    predicted_covs: _Array,
    transitions: _Array,
    motion_noises: _Array,
    lag: int | None = None,
) -> dict[str, _Array]: ...

@final
class LocalFrame:
    def __new__(cls, lat: float, lon: float, height: float, axes: str) -> LocalFrame: ...
    def rotation(self) -> _Array: ...
    def from_geodetic(self, positions: _Array) -> _Array: ...
    def to_geodetic(self, points: _Array) -> _Array: ...
    def from_ecef(self, points: _Array) -> _Array: ...
    def to_ecef(self, points: _Array) -> _Array: ...
    def cov_from_ecef(self, covs: _Array) -> _Array: ...
    def cov_to_ecef(self, covs: _Array) -> _Array: ...

def geodetic_to_ecef(positions: _Array) -> _Array: ...
def ecef_to_geodetic(points: _Array) -> _Array: ...
def fit_similarity(source: _Array, target: _Array, weights: _Array | None = None) -> dict[str, Any]: ...
def apply_similarity(
    scale: float,
    rotation: _Array,
    centre: _Array,
    image: _Array,
    centred_cov: _Array,
    points: _Array,
    covs: _Array,
) -> dict[str, Any]: ...
def place_array(
    elements: _Array,
    fixes: _Array,
    stds: _Array,
    origin: tuple[float, float, float],
) -> dict[str, Any]: ...
def covariance_intersection(
    states: Sequence[tuple[_Array, _Array]],
    criterion: str,
    weights: _Array | None = None,
) -> tuple[_Array, _Array]: ...
def start_state(
    times: _Array,
    fixes: Sequence[tuple[_Array, _Array]],
    order: int,
    motion: Motion | None = None,
) -> tuple[_Array, _Array]: ...
def paper_start(
    times: _Array,
    fixes: Sequence[tuple[_Array, _Array]],
    velocity_std: float,
    accel_std: float,
) -> tuple[_Array, _Array]: ...
def assign(costs: _Array) -> tuple[NDArray[np.int64], float]: ...
def chi_square_quantile(probability: float, dof: int) -> float: ...
def ospa(x: _Array, y: _Array, cutoff: float, order: float) -> dict[str, float]: ...
def gospa(truth: _Array, estimates: _Array, cutoff: float, order: float, alpha: float) -> dict[str, Any]: ...
def nees(errors: _Array, covs: _Array) -> dict[str, Any]: ...
def nis(innovations: _Array, covs: _Array) -> dict[str, Any]: ...
def cumulative(
    statistics: _Array,
    dof: NDArray[np.int64],
    restarts: Sequence[int],
    window: int | None = None,
) -> dict[str, Any]: ...
def whiteness(innovations: _Array, covs: _Array, lags: int) -> dict[str, Any]: ...
def evaluate(
    truth: Sequence[tuple[str, _Array, _Array]],
    times: _Array,
    offsets: Sequence[int],
    ids: Sequence[int],
    means: _Array,
    covs: _Array,
    cutoff: float,
    order: float,
    alpha: float,
    centres: _Array | None = None,
    region: float | None = None,
) -> dict[str, Any]: ...

@final
class Underwater:
    @staticmethod
    def make(
        array: Sensor,
        course: Mapping[str, Any],
        dt: float,
        gross: float,
        missing: float,
        jerk_std: float | None = None,
    ) -> Underwater: ...
    def times(self) -> _Array: ...
    def truth(self) -> _Array: ...
    def draw(self, seed: int, run: int) -> dict[str, Any]: ...

def reference_course() -> dict[str, Any]: ...
def reference_hydrophones() -> dict[str, Any]: ...
