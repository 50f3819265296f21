"""Loads that make posts sway, as shapes in time: what counts is their spectrum, not their size."""

import numpy as np

from fgloc.measurements import Array

KAIMAL_SCALE, KAIMAL_EXPONENT = 33.0, 5 / 3
MEAN_WIND_MPS, HEIGHT_M = 15.0, 10.0
"""A storm, at the height of the node."""


def sines(t_s: Array, frequencies_hz: tuple[float, ...], rng: np.random.Generator) -> Array:
    """Equal sines (N, 2) of the frequencies along x and y, each with a phase of its own."""
    phase_rad = rng.uniform(0, 2 * np.pi, (len(frequencies_hz), 2))
    angle = 2 * np.pi * t_s[:, None] * np.array(frequencies_hz)
    return np.sin(angle[:, :, None] + phase_rad).sum(1)


def gusts(n: int, rate_hz: int, rng: np.random.Generator) -> Array:
    """Load (n, 2) of gusts along x and y, independent, with the spectrum of `kaimal`.

    The drag of a wind U + u is that of U plus a part that grows with u U, so to first order the
    load has the spectrum of u. Its mean is left out: it bends the post once for all, which the
    survey sees.
    """
    frequency_hz: Array = np.fft.rfftfreq(n, 1 / rate_hz).astype(float)
    amplitude = np.sqrt(kaimal(frequency_hz))
    amplitude[0] = 0.0
    noise = rng.standard_normal((2, len(frequency_hz), 2))
    spectrum = amplitude[:, None] * (noise[0] + 1j * noise[1])
    return np.asarray(np.fft.irfft(spectrum, n, axis=0)) * np.sqrt(n)


def kaimal(frequency_hz: Array) -> Array:
    """Spectrum of along-wind turbulence, up to a factor: 1 / (1 + 33 n z / U)^(5/3).

    Kaimal et al., Spectral characteristics of surface-layer turbulence, QJRMS 98 (1972), in the
    form of Simiu and Scanlan.
    """
    reduced = frequency_hz * HEIGHT_M / MEAN_WIND_MPS
    return np.asarray((1 + KAIMAL_SCALE * reduced) ** -KAIMAL_EXPONENT)
