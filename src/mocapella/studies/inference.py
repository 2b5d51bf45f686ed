"""Statistical tests of few participants: means, repeated measures, mixed models, and corrections for many tests.

The docs (docs/studies-statistics.md) give the formulas, and docs/decisions/0063-statistics-of-studies.md the reasons.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.exports.needs import needed

Float64 = NDArray[np.float64]

CONFIDENCE: Final = 0.95
"""Level of all intervals, two-sided."""
RESAMPLES: Final = 4999
"""Number of bootstrap resamples."""
BOOTSTRAP_SEED: Final = 2015
NAN: Final = float("nan")
_TOO_ALIKE: Final = 1e-9
"""Standard deviation, relative to the largest value, below which values count as equal and are not tested."""


class MeanTest(msgspec.Struct, frozen=True):
    """Test of a mean over participants against a constant: Student's t and Wilcoxon's signed ranks.

    Attributes:
        n: number of participants.
        mean, sd: of their values, N − 1; in the unit of the values.
        low, high: t interval of the mean.
        t: statistic, with n − 1 degrees of freedom.
        p_below, p_above, p: that the mean is below, above, or other than the constant.
        w_below, w_above, w: the same by Wilcoxon's test.
        g: standardised distance from the constant, (mean − constant) ÷ sd, with Hedges' correction for few values.
        normal_p: p of Shapiro and Wilk's test that the values are from a normal distribution.

    NaN where there are too few participants, or all values are equal.
    """

    n: int
    mean: float
    sd: float = NAN
    low: float = NAN
    high: float = NAN
    t: float = NAN
    p_below: float = NAN
    p_above: float = NAN
    p: float = NAN
    w_below: float = NAN
    w_above: float = NAN
    w: float = NAN
    g: float = NAN
    normal_p: float = NAN


class EffectTest(msgspec.Struct, frozen=True):
    """Test of one effect, such as that of the placement.

    Attributes:
        effect: its name.
        n: number of participants in the test.
        symbol: of the statistic: `F` or `χ²`.
        statistic, df, error_df: its value and degrees of freedom; ``error_df`` is NaN for χ².
        p: without a correction.
        epsilon: Greenhouse and Geisser's estimate of the deviation from sphericity; NaN if there is no such correction.
        p_corrected: p with both degrees of freedom times ``epsilon``; equal to ``p`` without such a correction.
        size_symbol: of the effect size: `ηp²` or `W`, or empty.
        size, size_low, size_high: effect size and its interval.
    """

    effect: str
    n: int
    symbol: str
    statistic: float
    df: float
    error_df: float
    p: float
    epsilon: float
    p_corrected: float
    size_symbol: str = ""
    size: float = NAN
    size_low: float = NAN
    size_high: float = NAN


def alike(values: Float64) -> bool:
    """Whether values are equal but for rounding, so that their spread is not known."""
    return bool(np.ptp(values) <= _TOO_ALIKE * max(float(np.abs(values).max()), 1e-300))


def mean_test(values: Sequence[float] | Float64, against: float = 0.0) -> MeanTest:
    """Test the mean of one value for each participant against a constant.

    Args:
        values: (participants,) finite values, in any order and unit.
        against: the constant, in the same unit.
    """
    from scipy import stats

    own = np.sort(np.asarray(values, dtype=np.float64))
    n = len(own)
    if n < 2 or alike(own):
        return MeanTest(n, float(own.mean()) if n else NAN, 0.0 if n > 1 else NAN)
    mean, sd = float(own.mean()), float(own.std(ddof=1))
    error = sd / math.sqrt(n)
    t = (mean - against) / error
    reach = float(stats.t.ppf((1 + CONFIDENCE) / 2, n - 1)) * error
    below = float(stats.t.cdf(t, n - 1))
    above = float(stats.t.sf(t, n - 1))
    w = dict.fromkeys(("less", "greater", "two-sided"), NAN)
    if (moved := own - against).any():
        w = {side: float(stats.wilcoxon(moved, alternative=side).pvalue) for side in w}
    return MeanTest(
        n, mean, sd, mean - reach, mean + reach, t, below, above, min(1.0, 2 * min(below, above)),
        w["less"], w["greater"], w["two-sided"],
        hedges(n - 1) * (mean - against) / sd, float(stats.shapiro(own).pvalue) if n >= 3 else NAN,
    )  # fmt: skip


def hedges(df: int) -> float:
    """Return Hedges' factor J for few participants (1981, eq. 6e): exact, by the gamma function."""
    return math.exp(math.lgamma(df / 2) - math.lgamma((df - 1) / 2)) / math.sqrt(df / 2) if df > 1 else NAN


def bootstrap_interval(values: Sequence[float] | Float64) -> tuple[float, float]:
    """Return the interval of the mean by the bias-corrected and accelerated bootstrap (Efron, 1987), always the same.

    Args:
        values: (participants,) finite values, in any order.

    Returns:
        Lower and upper limit; NaN for fewer than three participants, or equal values.
    """
    from scipy import stats

    own = np.sort(np.asarray(values, dtype=np.float64))
    if len(own) < 3 or alike(own):
        return NAN, NAN
    found = stats.bootstrap(
        (own,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="BCa",
        rng=np.random.default_rng(BOOTSTRAP_SEED),
    )  # fmt: skip
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct p values for their number (Holm, 1979); NaN stays NaN, and does not count.

    Raises:
        SettingsError: statsmodels is not installed; names the extra.
    """
    own = np.asarray(p_values, dtype=np.float64)
    known = np.isfinite(own)
    if known.any():
        multitest = needed("statsmodels.stats.multitest", extra="studies")
        own[known] = multitest.multipletests(own[known], method="holm")[1]
    return [float(p) for p in own]


def repeated_measures(values: Float64, effects: tuple[str, str, str]) -> list[EffectTest]:
    """Analyse the variance of two factors that every participant has in all combinations.

    Each effect has its own error: the variance of its orthonormal contrasts over the participants, whose covariance
    also gives ε (Greenhouse and Geisser, 1959). ηp² has the interval of the noncentral F distribution (Steiger,
    2004), which takes the contrasts for spherical.

    Args:
        values: (participants, levels of the first factor, levels of the second one).
        effects: names of the first factor, the second one, and their interaction.

    Returns:
        The effects of factors with more than one level.
    """
    first, second = (contrasts(count) for count in values.shape[1:])
    means = [np.full((1, count), 1 / math.sqrt(count)) for count in values.shape[1:]]
    sides = ((first, means[1]), (means[0], second), (first, second))
    found = []
    for effect, (left, right) in zip(effects, sides, strict=True):
        scores = np.einsum("nij,ai,bj->nab", values, left, right).reshape(len(values), -1)
        if scores.shape[1]:
            found.append(_contrast_test(effect, scores, float(np.abs(values).max())))
    return found


def contrasts(levels: int) -> Float64:
    """Return orthonormal contrasts (levels − 1, levels): Helmert's."""
    rows: Float64 = np.array([[1.0] * k + [-k] + [0.0] * (levels - k - 1) for k in range(1, levels)]).reshape(
        -1, levels
    )
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _contrast_test(effect: str, scores: Float64, largest: float) -> EffectTest:
    """Test that the mean of contrast scores (participants, contrasts) is zero."""
    from scipy import stats

    n, df = scores.shape
    error_df = df * (n - 1)
    covariance = np.atleast_2d(np.cov(scores, rowvar=False))
    spread = float(np.trace(covariance))
    if spread <= (_TOO_ALIKE * largest) ** 2:
        return EffectTest(effect, n, "F", NAN, df, error_df, NAN, NAN, NAN, "ηp²")
    f = n * float((scores.mean(axis=0) ** 2).sum()) / spread
    epsilon = spread**2 / (df * float((covariance**2).sum()))
    p, corrected = (float(stats.f.sf(f, e * df, e * error_df)) for e in (1.0, epsilon))
    low, high = _noncentral_limits(f, df, error_df)
    size = df * f / (df * f + error_df)
    return EffectTest(effect, n, "F", f, df, error_df, p, epsilon, corrected, "ηp²", size, low, high)


def _noncentral_limits(f: float, df: float, error_df: float) -> tuple[float, float]:
    """Return the interval of ηp² = λ ÷ (λ + df + error_df + 1)."""
    from scipy import optimize, special

    def noncentrality(probability: float) -> float:
        def beyond(value: float) -> float:
            return float(special.ncfdtr(df, error_df, value, f)) - probability

        if beyond(0.0) <= 0:
            return 0.0
        upper = max(1.0, 2 * df * f)
        while beyond(upper) > 0:
            upper *= 2
        return float(optimize.brentq(beyond, 0.0, upper))

    both = (noncentrality((1 + CONFIDENCE) / 2), noncentrality((1 - CONFIDENCE) / 2))
    low, high = (value / (value + df + error_df + 1) for value in both)
    return low, high


def residual_normality(values: Float64) -> float:
    """Return p of Shapiro and Wilk's test of the residuals of `repeated_measures`, the errors of all effects together.

    Args:
        values: (participants, levels, levels), as there.
    """
    from scipy import stats

    rest = values - values.mean(axis=(1, 2), keepdims=True)
    rest = rest - rest.mean(axis=0)
    if rest.size < 3 or np.ptp(rest) <= _TOO_ALIKE * np.abs(values).max():
        return NAN
    return float(stats.shapiro(rest).pvalue)


def friedman(effect: str, values: Float64) -> EffectTest:
    """Test by ranks that the levels of one factor do not differ (Friedman, 1937), with Kendall's W as the effect size.

    Args:
        effect: its name.
        values: (participants, levels).
    """
    from scipy import stats

    n, levels = values.shape
    if levels < 3:  # two levels are Wilcoxon's test
        return EffectTest(effect, n, "χ²", NAN, levels - 1, NAN, NAN, NAN, NAN, "W")
    with np.errstate(invalid="ignore", divide="ignore"):
        found = stats.friedmanchisquare(*values.T)
    chi2, p = float(found.statistic), float(found.pvalue)
    return EffectTest(effect, n, "χ²", chi2, levels - 1, NAN, p, NAN, p, "W", chi2 / (n * (levels - 1)))


def mixed_effects(
    values: Sequence[float], factors: Sequence[tuple[str, str]], groups: Sequence[str], effects: tuple[str, str, str]
) -> list[EffectTest]:
    """Test two factors where some participants lack some combinations: a linear model with one intercept for each one.

    Likelihood ratios of models with and without an effect, fitted by maximum likelihood; of a factor's effect without
    the interaction.

    Args:
        values: one for each participant and combination that exists.
        factors: levels of both factors, for each value.
        groups: participant of each value.
        effects: names of the first factor, the second one, and their interaction.

    Returns:
        The effects of factors with more than one level; NaN for a model that cannot be fitted.

    Raises:
        SettingsError: statsmodels is not installed; names the extra.
    """
    first, second = (_dummies([pair[k] for pair in factors]) for k in range(2))
    both = np.einsum("ni,nj->nij", first, second).reshape(len(first), -1)
    ones, n = np.ones((len(values), 1)), len(set(groups))
    found = []
    for effect, tested, rest in zip(
        effects, (first, second, both), ((second,), (first,), (first, second)), strict=True
    ):
        if tested.shape[1]:
            null = np.hstack([ones, *rest])
            chi2 = 2 * (_likelihood(values, np.hstack([null, tested]), groups) - _likelihood(values, null, groups))
            df = np.linalg.matrix_rank(np.hstack([null, tested])) - np.linalg.matrix_rank(null)
            found.append(_ratio_test(effect, n, max(chi2, 0.0) if math.isfinite(chi2) else NAN, int(df)))
    return found


def _ratio_test(effect: str, n: int, chi2: float, df: int) -> EffectTest:
    from scipy import stats

    p = float(stats.chi2.sf(chi2, df)) if df else NAN
    return EffectTest(effect, n, "χ²", chi2 if df else NAN, df, NAN, p, NAN, p)


def _dummies(levels: Sequence[str]) -> Float64:
    """Return columns (values, levels − 1) that name the levels, as deviations from the last one."""
    names = sorted(set(levels))
    columns = np.array([[float(level == name) for name in names] for level in levels])
    return np.asarray(columns[:, :-1] - columns[:, -1:])


def _likelihood(values: Sequence[float], columns: Float64, groups: Sequence[str]) -> float:
    """Return the largest log-likelihood of a model with a random intercept; NaN if it is not found."""
    mixed: Any = needed("statsmodels.regression.mixed_linear_model", extra="studies")
    order = sorted(range(len(values)), key=lambda k: (groups[k], columns[k].tolist(), values[k]))
    model = mixed.MixedLM(
        np.asarray(values, dtype=np.float64)[order],
        columns[order][:, _independent(columns)],
        groups=np.asarray(groups)[order],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a variance of zero is valid; a fit that did not converge is NaN
        try:
            fitted = model.fit(reml=False)
        except (np.linalg.LinAlgError, ValueError):
            return NAN
    return float(fitted.llf) if fitted.converged else NAN


def _independent(columns: Float64) -> list[int]:
    """Return the indices of as many columns as are linearly independent."""
    from scipy import linalg

    r, pivots = linalg.qr(columns, mode="r", pivoting=True)
    rank = int((np.abs(np.diag(r)) > 1e-9 * abs(r[0, 0])).sum())
    return sorted(pivots[:rank].tolist())
