"""What tuning gives: the configuration, what was found of each setting, how consistent it is."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from fgloc.config import SmoothConfig

Status = Literal["found", "bounded", "kept"]
FEW = 0.5
"""Below this share of what they claim, the fixes' scatter says that their errors are slow."""
MEANING = {
    "found": "found",
    "bounded": "what was given is too far off; about where the drive tells no more",
    "kept": "as given: the drive does not determine it",
}


@dataclass(frozen=True)
class TunedSetting:
    """A setting by its key in the configuration, before and after.

    status         'found', 'bounded' (the drive shows only that what was given is too large or too
                   small) or 'kept' (the drive says nothing of it)
    relative_sigma standard deviation of its logarithm where it was found, else None
    """

    key: str
    before: float
    after: float
    status: Status
    relative_sigma: float | None


@dataclass(frozen=True)
class Consistency:
    """Unseen fixes as predicted with so many withheld in a row, before and after.

    outage_s        how long the gap is, in s
    n, worth        how many were compared, and as how many independent ones they count
    nis_...         mean NIS over its degrees of freedom; 1 is consistent
    low, high       the band that holds 95 % of what is consistent
    log_likelihood_...  mean of a fix, without the constant
    """

    fixes: int
    outage_s: float
    n: int
    worth: float
    nis_before: float
    nis_after: float
    low: float
    high: float
    log_likelihood_before: float
    log_likelihood_after: float

    @property
    def consistent(self) -> bool:
        """Whether the NIS after lies within its band."""
        return self.low <= self.nis_after <= self.high


@dataclass(frozen=True)
class AidConsistency:
    """Measurements of one source, on stretches that the search has not seen, as all others predict
    them, before and after.

    n, worth  how many were compared, and as how many independent ones they count
    nis_...   mean NIS over its degrees of freedom; 1 is consistent
    low, high the band that holds 95 % of what is consistent
    outliers  how many of the whole drive lie far beyond the bulk and took no part
    """

    source: str
    n: int
    worth: float
    nis_before: float
    nis_after: float
    low: float
    high: float
    outliers: int

    @property
    def consistent(self) -> bool:
        """Whether the NIS after lies within its band."""
        return self.low <= self.nis_after <= self.high


@dataclass(frozen=True)
class Tuning:
    """The noise found for a drive; `config` is ready for `fgloc.smooth`.

    consistency  of the fixes on stretches that the search has not seen, by length of the gap
    aids         the same of wheels, nodes and what else aids
    fixes        how many usable ones there were; `outliers` of them were left out
    """

    drive: str
    config: SmoothConfig
    settings: tuple[TunedSetting, ...]
    consistency: tuple[Consistency, ...]
    fixes: int
    outliers: int
    evaluations: int
    aids: tuple[AidConsistency, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What its user should know beside the numbers."""
        said = [
            f"over gaps of {', '.join(gaps)} s the NIS stays outside its band: the covariance that "
            f"is claimed there is too {size}"
            for size, gaps in (
                ("small", self._gaps(above=True)),
                ("large", self._gaps(above=False)),
            )
            if gaps
        ]
        if self.outliers:
            said.append(f"{self.outliers} of {self.fixes} fixes were left out as outliers")
        for one in self.aids:
            if one.outliers:
                said.append(f"{one.outliers} rows of {one.source} took no part: outliers")
            if not one.consistent:
                size = "small" if one.nis_after > one.high else "large"
                said.append(f"the NIS of {one.source} stays outside its band on stretches that the "
                            f"search has not seen: its sigma is too {size} there")  # fmt: skip
        if self.config.gnss.sigma_scale < FEW and not self.config.gnss.bias_sigma_m:
            said.append(
                "the fixes scatter far less than they claim; a receiver that filters makes its "
                "errors slow, and slow errors do not show here: start from gnss.bias_sigma_m=1 to "
                "ask for them, or keep gnss.sigma_scale=1"
            )
        if self.config.detections.sigma_scale < FEW:
            said.append(
                "what nodes see scatters far less than it claims: its errors are slow, and slow "
                "errors do not show here; state them (bias_sigma_m and bias_tau_s in [[node]]) or "
                "keep detections.sigma_scale=1"
            )
        return tuple(said)

    def _told(self) -> dict[str, Any]:
        """What differs from the defaults and what was found; the seed is that of a run."""
        told = self.config.model_dump(exclude_defaults=True, exclude={"seed"})
        for one in self.settings:
            if one.status != "kept":
                section, _, name = one.key.partition(".")
                told.setdefault(section, {})[name] = one.after
        return told

    def _gaps(self, *, above: bool) -> list[str]:
        """Lengths in s whose NIS lies above its band, or below it."""
        return [
            f"{one.outage_s:.3g}"
            for one in self.consistency
            if (one.nis_after > one.high if above else one.nis_after < one.low)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "drive": self.drive,
            "config": self._told(),
            "settings": [asdict(one) for one in self.settings],
            "consistency": [
                asdict(one) | {"consistent": one.consistent} for one in self.consistency
            ],
            "aids": [asdict(one) | {"consistent": one.consistent} for one in self.aids],
            "fixes": self.fixes, "outliers": self.outliers, "evaluations": self.evaluations,
            "remarks": list(self.remarks),
        }  # fmt: skip

    def to_toml(self) -> str:
        """The text of a configuration file, with what was found as comments."""
        import tomli_w

        lines = [
            f"Noise tuned on drive {self.drive}, {self.fixes} fixes.",
            *(_of_setting(one) for one in self.settings),
            "Mean NIS / dof on stretches that the search has not seen:",
            *(_of_gap(one) for one in self.consistency),
            *(_of_aid(one) for one in self.aids),
            *(f"Remark: {remark}." for remark in self.remarks),
        ]
        head = "".join(f"# {' '.join(line.split())}\n" for line in lines)
        return f"{head}\n{tomli_w.dumps(self._told())}"


def _of_setting(one: TunedSetting) -> str:
    unsure = "" if one.relative_sigma is None else f" +- {100 * one.relative_sigma:.0f} %"
    change = "" if one.status == "kept" else f"; was {one.before:.4g}"
    return f"{one.key} = {one.after:.4g}{unsure}: {MEANING[one.status]}{change}"


def _of_aid(one: AidConsistency) -> str:
    return (
        f"{one.source}, by all others: {one.nis_before:.3g} before, {one.nis_after:.3g} after "
        f"(consistent: {one.low:.2f} to {one.high:.2f}; {one.n} rows, worth {one.worth:.0f})"
    )


def _of_gap(one: Consistency) -> str:
    return (
        f"gaps of {one.outage_s:.3g} s: {one.nis_before:.3g} before, {one.nis_after:.3g} after "
        f"(consistent: {one.low:.2f} to {one.high:.2f}; {one.n} fixes, worth {one.worth:.0f}); "
        f"log-likelihood {one.log_likelihood_before:.3f} before, {one.log_likelihood_after:.3f} "
        "after"
    )
