"""First bending mode of a light post: a hollow cylinder, clamped at the ground, perhaps with a top.

Khamooshi, Cooperative perception and localization with infrastructure sensor nodes (Waterloo,
2023), section 3.6. A clamped Euler-Bernoulli beam of height h carries a mass M at its tip:

    shape       phi(s) = cosh(b s) - cos(b s) - g (sinh(b s) - sin(b s)), 0 <= s <= h
                g = (cosh(bh) + cos(bh)) / (sinh(bh) + sin(bh)): no moment at the tip
    tip mass    1 + cosh(bh) cos(bh) = M / m bh (sin(bh) cosh(bh) - cos(bh) sinh(bh))
    frequency   w = b^2 sqrt(E I / mu), mu the mass per length; without a tip mass bh = 1.8751 and
                b^2 = 3.516 / h^2, Eq. (3.21)
    tip slope   phi'(h) / phi(h), how much the tip tilts for each metre that it is moved

# Differs from the paper: (3.21) divides by the total mass, which is no frequency; it is the mass
per length. (3.24) divides the load by the total mass; it is the modal mass here, the one that a
load at the tip moves by what statics says, 3 E I / h^3 over w^2: 0.2427 of the mass of a uniform
post. (The first mode alone has a quarter; the rest of the static bending belongs to modes so fast
that they follow at once.)

m     total mass of the post          mass_kg
E, I  modulus, moment of inertia      youngs_modulus_pa, second_moment_m4
xi    damping ratio                   damping
alpha mass-proportional damping       mass_damping_per_s, Eq. (3.25)
"""

import math
from dataclasses import dataclass
from functools import cached_property

from fgloc.errors import InputError
from fgloc.infrastructure import Post

ALUMINIUM_MODULUS_PA, ALUMINIUM_DENSITY_KGPM3 = 70e9, 2700.0


@dataclass(frozen=True)
class HollowPost:
    """A hollow cylinder, by default of the paper's aluminium.

    Raises InputError where a number is not positive or the wall is thicker than the radius.

    height_m          from the ground to the node
    diameter_m        outer
    wall_m            its thickness
    top_mass_kg       what the tip carries: the node, a lamp
    """

    height_m: float
    diameter_m: float
    wall_m: float
    top_mass_kg: float = 0.0
    youngs_modulus_pa: float = ALUMINIUM_MODULUS_PA
    density_kgpm3: float = ALUMINIUM_DENSITY_KGPM3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least_is_fine = name == "top_mass_kg" and value == 0
            if not math.isfinite(value) or (value <= 0 and not least_is_fine):
                raise InputError(f"post: {name} = {value}: expected a number above 0")
        if self.wall_m > self.diameter_m / 2:
            raise InputError(
                f"post: wall_m = {self.wall_m} is more than half of diameter_m = {self.diameter_m}"
            )

    @property
    def mass_kg(self) -> float:
        """Of the whole cylinder, without what it carries."""
        area_m2 = math.pi / 4 * (self.diameter_m**2 - self._inner_m**2)
        return self.density_kgpm3 * area_m2 * self.height_m

    @property
    def second_moment_m4(self) -> float:
        """I of the ring."""
        return math.pi / 64 * (self.diameter_m**4 - self._inner_m**4)

    @property
    def tip_stiffness_npm(self) -> float:
        """Static: newtons at the tip for each metre that it moves."""
        return 3 * self._bending_nm2 / self.height_m**3

    @property
    def angular_frequency_radps(self) -> float:
        """w of the first mode. # Eq. (3.21), mass per length"""
        b = self._wave_number / self.height_m
        return b**2 * math.sqrt(self._bending_nm2 * self.height_m / self.mass_kg)

    @property
    def modal_mass_kg(self) -> float:
        """What a load at the tip has to move."""
        return self.tip_stiffness_npm / self.angular_frequency_radps**2

    @property
    def tip_slope_per_m(self) -> float:
        """Tilt in rad for each metre of the tip's displacement."""
        x = self._wave_number
        sin, cos, sinh, cosh = math.sin(x), math.cos(x), math.sinh(x), math.cosh(x)
        g = (cosh + cos) / (sinh + sin)
        return x / self.height_m * (sinh + sin - g * (cosh - cos)) / (cosh - cos - g * (sinh - sin))

    @property
    def _inner_m(self) -> float:
        return self.diameter_m - 2 * self.wall_m

    @property
    def _bending_nm2(self) -> float:
        return self.youngs_modulus_pa * self.second_moment_m4

    @cached_property
    def _wave_number(self) -> float:
        """bh, the first root of the frequency equation: 1.8751, or less with a tip mass."""
        from scipy.optimize import brentq

        carried = self.top_mass_kg / self.mass_kg

        def equation(x: float) -> float:
            sin, cos, sinh, cosh = math.sin(x), math.cos(x), math.sinh(x), math.cosh(x)
            return 1 + cosh * cos - carried * x * (sin * cosh - cos * sinh)

        return float(brentq(equation, 1e-6, 2.0, xtol=1e-14))


def mass_damping_per_s(angular_frequency_radps: float, damping: float) -> float:
    """alpha of mass-proportional damping. # Eq. (3.25)

    The paper wants it between 1 and 2 w, of which the upper bound says that the post swings.
    """
    return 2 * damping * angular_frequency_radps


def post_of(
    node: str, beam: HollowPost, damping: float, load_sigma_n: float, load_tau_s: float,
    *, straight: bool = False,
) -> Post:  # fmt: skip
    """The post that carries a node, as estimators know it.

    `straight` takes the paper's tilt x / h of Eq. (3.19), that of a stiff post with a hinge at its
    foot, for the slope of the bent one, which is 1.377 times as large without a tip mass.
    """
    return Post(
        node, beam.height_m, beam.angular_frequency_radps / (2 * math.pi), damping,
        beam.modal_mass_kg, 1 / beam.height_m if straight else beam.tip_slope_per_m,
        load_sigma_n, load_tau_s,
    )  # fmt: skip
