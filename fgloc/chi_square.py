"""Quantiles of chi-square in plain Python: scipy would cost every run 0.3 s to import.

The regularised incomplete gamma function by its power series and its continued fraction (Numerical
Recipes, 3rd ed., section 6.2), inverted by Halley's method from the start of Wilson and Hilferty.
"""

import math
from functools import cache
from statistics import NormalDist

_EPS = 2.0**-53
_TINY = 1e-300
_STIRLING_FROM = 30.0


@cache
def chi2_quantile(probability: float, dof: float) -> float:
    """The value that chi-square with `dof` degrees of freedom (any number above 0) stays below.

    0.95 with 3 degrees gives 7.815; probability 1 gives infinity. Raises ValueError where the
    probability is outside [0, 1] or dof is not above 0.
    """
    if not 0 <= probability <= 1 or not dof > 0:
        raise ValueError(f"no quantile of chi-square for {probability} with {dof} degrees")
    if probability in (0, 1):
        return 0.0 if probability == 0 else math.inf
    a = dof / 2
    x = _first_guess(probability, a)
    for _ in range(100):
        step = _halley_step(x, a, probability)
        x = x - step if step < x else x / 2
        if abs(step) <= 4 * _EPS * x:
            break
    return 2 * x


def gamma_p(a: float, x: float) -> tuple[float, float]:
    """Regularised incomplete gamma functions P(a, x) and Q(a, x) = 1 - P."""
    if x <= 0:
        return 0.0, 1.0
    if x < a + 1:
        p = _density(a, x) * x * _series(a, x)
        return p, 1 - p
    q = _density(a, x) * x * _continued_fraction(a, x)
    return 1 - q, q


def _halley_step(x: float, a: float, probability: float) -> float:
    """One step down towards the root; the smaller of the two tails keeps its digits."""
    p, q = gamma_p(a, x)
    miss = p - probability if probability < 0.5 else (1 - probability) - q
    density = _density(a, x)
    if density == 0:
        return x / 2 if miss > 0 else -x
    newton = miss / density
    return newton / max(1 - 0.5 * newton * ((a - 1) / x - 1), 0.5)


def _first_guess(probability: float, a: float) -> float:
    """Half the quantile by Wilson and Hilferty, or by the leading term where that is below 0."""
    z = NormalDist().inv_cdf(probability)
    root = 1 - 1 / (9 * a) + z / (3 * math.sqrt(a))
    if root > 0.2:
        return a * root**3
    return math.exp((math.log(probability) + math.lgamma(a + 1)) / a)


def _density(a: float, x: float) -> float:
    """x^(a-1) e^-x / Gamma(a), by Stirling's series where a is large."""
    if a < _STIRLING_FROM:
        return math.exp((a - 1) * math.log(x) - x - math.lgamma(a))
    off = (x - a) / a
    correction = 1 / (12 * a) - 1 / (360 * a**3) + 1 / (1260 * a**5)
    exponent = a * (math.log1p(off) - off) - correction
    return math.exp(exponent) * math.sqrt(a / (2 * math.pi)) / x


def _series(a: float, x: float) -> float:
    """The sum of x^n / (a (a+1) ... (a+n)), which converges fast for x below a + 1."""
    term = total = 1 / a
    n = a
    while term > total * _EPS:
        n += 1
        term *= x / n
        total += term
    return total


def _continued_fraction(a: float, x: float) -> float:
    """Lentz's evaluation of 1 / (x + 1 - a - 1 (1 - a) / (x + 3 - a - ...)), for x above a + 1."""
    b = x + 1 - a
    c, d = 1 / _TINY, 1 / b
    h, i = d, 0
    while True:
        i += 1
        an = -i * (i - a)
        b += 2
        d = an * d + b
        d = 1 / (d if abs(d) > _TINY else _TINY)
        c = b + an / c
        c = c if abs(c) > _TINY else _TINY
        h *= d * c
        if abs(d * c - 1) <= 4 * _EPS:
            return h
