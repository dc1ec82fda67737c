"""Fitting a set of primaries' matrix to XYZ to the colours it is to reproduce.

`python -m calibration.optimise darling2011` makes the files in data/primaries/darling2011 anew.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, delta_e_2000_parts, lab
from calibration.primaries import Primaries, gaussians, write
from calibration.spectra import Spectra

# Section "Selection of Rendering Primaries" of the paper.
DARLING_PEAKS_NM = np.array([447.0, 481.5, 519.6, 543.1, 572.9, 622.4])
DARLING_WIDTHS_NM = np.array([16.9, 4.3, 7.8, 9.4, 15.5, 18.0])

# White counts as this share of all surfaces: what is white in one light must be in every other,
# and captured light is judged by the white it falls on.
WHITE_SHARE = 0.2


def true_lab(lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
    """CIELAB (L, S, 3) of surfaces under lights, from full spectra, adapted to D65."""
    stimuli = np.einsum("wl,ws->lsw", lights.values, surfaces.values)
    return adapted_lab(sets.xyz(stimuli), lights)


def adapted_lab(xyz, lights: Spectra) -> NDArray[np.float64]:
    """CIELAB (L, S, 3) of XYZ (L, S, 3) seen under lights, as corresponding colours for D65.

    Each light's own true white is scaled to Y = 1 and adapted from, fully, by CAT02.
    """
    whites = sets.xyz(lights.values.T)
    to_d65 = np.stack([cat02(white / white[1], D65) / white[1] for white in whites])
    return lab(np.einsum("lij,lsj->lsi", to_d65, xyz))


def products(curves, lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
    """Light times surface (L, S, N) channel by channel: equation 2 of the paper."""
    return (lights.values.T @ curves)[:, None, :] * (surfaces.values.T @ curves)[None]


def rendering_errors(
    primaries: Primaries, lights: Spectra, surfaces: Spectra
) -> NDArray[np.float64]:
    """CIEDE2000 (L, S) between light times surface done in primaries and done in full spectra."""
    rendered = products(primaries.curves, lights, surfaces) @ primaries.xyz_from_primaries.T
    return delta_e_2000(true_lab(lights, surfaces), adapted_lab(rendered, lights))


def fit_matrix(
    curves, lights: Spectra, surfaces: Spectra, white_share: float = WHITE_SHARE
) -> NDArray[np.float64]:
    """The matrix (3, N) to XYZ with the least sum of squared CIEDE2000 over lights x surfaces.

    curves       (36, N), each summing to 1
    surfaces     without white, which is added with the weight of white_share of them all; 0: not
    white_share  see WHITE_SHARE
    returns      (3, N), equal-energy light of unit radiance on white has exactly Y = 1
    """
    from scipy.optimize import least_squares  # .8 s

    count = len(surfaces)
    root_weights = np.ones(count)
    if white_share > 0.0:
        surfaces = _with_white(surfaces)
        root_weights = np.append(root_weights, np.sqrt(white_share * count))
    phi = products(curves, lights, surfaces)
    target = true_lab(lights, surfaces)
    stimuli = np.einsum("wl,ws->lsw", lights.values, surfaces.values)
    flat = phi.reshape(-1, phi.shape[-1])
    start = np.linalg.lstsq(flat, sets.xyz(stimuli).reshape(-1, 3), rcond=None)[0].T

    def parts(matrix):
        rendered = adapted_lab(phi @ matrix.reshape(3, -1).T, lights)
        return (delta_e_2000_parts(target, rendered) * root_weights[:, None]).ravel()

    found = least_squares(parts, start.ravel(), method="lm", x_scale=np.abs(start.ravel()))
    matrix = found.x.reshape(3, -1)
    return matrix / matrix[1].sum()


def darling2011() -> Primaries:
    """The paper's Gaussians with a matrix fitted as the paper's was, on surfaces that ship.

    The paper prints the Gaussians but not the matrix, and its 100 artists' paints are not public.
    """
    lights, surfaces = sets.lights("darling2011"), sets.surfaces("ces99+rawtoaces190")
    # Rounded here, so that the figures are those of the files as they ship.
    curves = np.round(gaussians(DARLING_PEAKS_NM, DARLING_WIDTHS_NM), 9)
    matrix = np.round(fit_matrix(curves, lights, surfaces), 6)
    primaries = Primaries("darling2011", curves, matrix, _DARLING_TEXT)
    figures = [
        f"{what}: {_summary(rendering_errors(primaries, lights, sets.surfaces(name)))}"
        for what, name in (
            ("CES99 + 190 patches (trained on)", "ces99+rawtoaces190"),
            ("ColorChecker (not trained on)", "colorchecker24"),
            ("white", "white"),
        )
    ]
    text = "\n".join([_DARLING_TEXT, *figures])
    return Primaries("darling2011", curves, matrix, text)


_DARLING_TEXT = """\
Curves: the six Gaussians of Darling, Ferwerda, Berns, Chen, "Real-Time Multispectral Rendering
with Complex Illumination" (CIC 19, 2011), each normalised to sum 1 on 380..730/10 nm.
Matrix: not printed in the paper; fitted here (calibration/optimise.py) to the least sum of squared
CIEDE2000 after CAT02 to D65 under the paper's 19 lights. The paper's 100 artists' paints are not
public: CES99 and rawtoaces' 190 patches, with white as a fifth of them, stand in; for the measured
D50 booth the lamp F40/C50 does.
CIEDE2000 under the 19 lights, mean/sd/max/90th percentile:"""


def _summary(errors) -> str:
    spread = (errors.mean(), errors.std(), errors.max(), np.percentile(errors, 90))
    return "/".join(f"{v:.2f}" for v in spread)


def _with_white(surfaces: Spectra) -> Spectra:
    white = np.ones((len(surfaces.wavelengths), 1))
    return Spectra(
        surfaces.wavelengths,
        (*surfaces.names, "white"),
        np.concatenate([surfaces.values, white], axis=1),
    )


def main(arguments: list[str]) -> int:
    if arguments != ["darling2011"]:
        print("usage: python -m calibration.optimise darling2011", file=sys.stderr)
        return 2
    write(darling2011(), Path(__file__).parent / "data" / "primaries" / "darling2011")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
