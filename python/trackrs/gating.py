"""Gates: which reports a track may get."""

from __future__ import annotations

from dataclasses import dataclass

from trackrs import _trackrs


@dataclass(frozen=True, slots=True)
class Gate:
    """An ellipsoidal gate that holds a target's own report with this probability.

    Args:
        probability: in [0, 1]; 1 lets everything through.

    Example:
        >>> import trackrs as tr
        >>> round(tr.Gate(0.99).threshold(2), 4)
        9.2103
    """

    probability: float = 0.99

    def threshold(self, dof: int) -> float:
        """Return the bound on the squared Mahalanobis distance for `dof` observed components.

        Raises:
            ParameterError: the probability is outside [0, 1] or `dof` is 0.
        """
        return _trackrs.chi_square_quantile(self.probability, dof)
