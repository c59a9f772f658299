"""The parameters of PCWLAD, in which the methods of this package and those of its authors agree.

References
----------
.. [1] Huang, T. et al. (2025), PCWLAD, arXiv:2508.10294; the filters are those of its authors' maps.
.. [2] Shen, X. et al. (2015), Mutual-structure for joint filtering, doi:10.1109/ICCV.2015.389.
.. [3] Wang, Z. et al. (2004), Image quality assessment, doi:10.1109/TIP.2003.819861.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class PaperParameters:
    """Numbers as they are published."""

    luminance_exponent: float = 0.5
    """α, the exponent of the luminance term of the SSIM [1]_ (eq. 3-4)."""
    contrast_exponent: float = 0.8
    """β, that of the contrast term."""
    structure_exponent: float = 1.3
    """γ, that of the structure term."""
    c_luminance: float = 0.01**2
    """C₁ stabilises the luminance term where both means are near 0, for a range of 1 [3]_."""
    c_contrast: float = 0.03**2
    """C₂ stabilises the contrast term of flat windows, and half of it the structure term [3]_."""
    filter_iterations: int = 20
    """Number of alternating steps of the mutual-structure filter [2]_."""
    filter_radius_px: int = 3
    """Half side of its square neighbourhood [2]_."""
    lambda_reference: float = 30.0
    """λ_G, the weight of the filtered reference window's distance from its input [2]_."""
    lambda_target: float = 1.0
    """λ_I, the same of the target window [2]_."""
    epsilon_reference: float = 5e-4
    """ε_G, the variance below which the reference window counts as flat [2]_."""
    epsilon_target: float = 1e-4
    """ε_I, the same of the target window [2]_."""
    least_wavelength_px: float = 3.0
    """Wavelength of the finest scale of the log-Gabor filters [1]_."""
    wavelength_factor: float = 1.6
    """Ratio of the wavelengths of successive scales [1]_."""
    sigma_on_f: float = 0.75
    """Ratio of the standard deviation of a filter to its centre frequency [1]_."""
    low_pass_cut_off: float = 0.45
    """Cut-off frequency of the low-pass filter, cycles per pixel [1]_."""
    low_pass_power: int = 30
    """Exponent of the low-pass filter [1]_."""
    spread_cut_off: float = 0.5
    """Frequency spread at which the weight of the phase congruency is one half [1]_."""
    spread_gain: float = 3.0
    """Gain of the sigmoid that weights the phase congruency by the frequency spread [1]_."""
    moment_epsilon: float = 1e-4
    """The ε that is added to the maximum moment [1]_."""
    byte_epsilon: float = 1e-4
    """The ε of the phase congruency for an image of range 255 [1]_."""


PAPER: Final = PaperParameters()
"""Those in use."""
