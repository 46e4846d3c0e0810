"""Exceptions. Each is a `TrackrsError` and the built-in exception that fits it best."""


class TrackrsError(Exception):
    """Base of everything that trackrs raises."""


class ParameterError(TrackrsError, ValueError):
    """A parameter is outside its domain; the message names it."""


class DimensionError(TrackrsError, ValueError):
    """Two shapes that must agree do not; the message names both."""


class NonFiniteError(TrackrsError, ValueError):
    """A number that must be finite is NaN or infinite, or a result has become so."""


class TimeError(TrackrsError, ValueError):
    """Time went backwards."""


class UnknownSensorError(TrackrsError, KeyError):
    """A scan names a sensor that the tracker does not have."""

    __str__ = Exception.__str__  # KeyError would show the message in quotes


class UnobservableError(TrackrsError, ArithmeticError):
    """A sensor has no value or no derivative at a state, for example a target on the sensor."""


class NotPositiveDefiniteError(TrackrsError, ArithmeticError):
    """A Cholesky factorisation failed; the message names the matrix and the pivot."""


class StateError(TrackrsError, ValueError):
    """Saved bytes cannot be read, or a value cannot be saved."""


class StrictError(TrackrsError, RuntimeError):
    """Strict mode turned an event into an error."""


class BusyError(TrackrsError, RuntimeError):
    """A tracker was used by two threads at once."""


class InternalError(TrackrsError, RuntimeError):
    """A fault of trackrs itself; please report it."""
