"""A display as it was measured: a matrix with black correction, and a curve for each channel.

E. A. Day, L. Taplin, R. S. Berns, "Colorimetric characterization of a computer-controlled liquid
crystal display", Color Research and Application 29(5), 2004: XYZ = black + M (R, G, B), each
channel's linear light by a look-up table of its drive level.

The measurements are a CSV `R,G,B,X,Y,Z`: drive levels as they were sent (0..255, 0..1023, 0..1, any
full scale) and what the instrument read, in cd/m2 or any unit that is the same for all rows. There
must be black, a ramp of each channel up to full drive, and the white; greys serve the matrix,
mixed colours are kept for judging the model.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.difference import delta_e_2000, delta_e_2000_parts, lab
from calibration.display import Array, Display
from calibration.errors import InputError, Problem, fault, read_text

COLUMNS = ("R", "G", "B", "X", "Y", "Z")
LEVELS = 5  # of a channel's ramp at least, black and full drive among them
_CHANNELS = ("red", "green", "blue")
_MOST_PROBLEMS = 10
_NOISE = 0.003  # of full light: a ramp may fall by so much, as instruments scatter near black
_STEPS = 4097  # of the curves' tables: a quarter of a 10-bit step


@dataclass(frozen=True)
class Samples:
    """What was sent and what was read.

    drive  (n, 3) in [0, 1] of full drive
    xyz    (n, 3) in the instrument's unit
    full   what full drive is called in the file: 255, 1023, 1
    """

    drive: Array
    xyz: Array
    full: float = 1.0

    @property
    def black(self) -> NDArray[np.bool_]:
        return np.asarray((self.drive == 0).all(axis=1))

    @property
    def white(self) -> NDArray[np.bool_]:
        return np.asarray((self.drive == 1).all(axis=1))

    @property
    def grey(self) -> NDArray[np.bool_]:
        """Equal drives, black and white among them."""
        return np.asarray((self.drive == self.drive[:, :1]).all(axis=1))

    def ramp(self, channel: int) -> NDArray[np.bool_]:
        """This channel alone, black among them."""
        return np.asarray((np.delete(self.drive, channel, axis=1) == 0).all(axis=1))

    @property
    def mixed(self) -> NDArray[np.bool_]:
        """Neither black, nor grey, nor one channel alone."""
        return ~(self.grey | self.ramp(0) | self.ramp(1) | self.ramp(2))


@dataclass(frozen=True)
class Errors:
    """CIEDE2000 between a model and measurements, the measured white as white.

    mean, max  of `count` samples; NaN of none
    worst      (3,) drive of the sample with the greatest, in [0, 1]; empty of none
    """

    mean: float
    max: float
    count: int
    worst: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Characterisation:
    """A display's model, and how well it tells what was measured.

    display   the model
    fitted    errors on what it was made from: black, ramps and greys
    left_out  errors on mixed colours, which it has not seen; a count of 0 where there are none
    inverse   errors, on all samples, of what the model shows when the measured XYZ is asked of it:
              colours it cannot reach, as by its own account it is clipped
    samples   the measurements
    """

    display: Display
    fitted: Errors
    left_out: Errors
    inverse: Errors
    samples: Samples

    @property
    def additivity(self) -> float:
        """Luminance of the three primaries, measured one by one, over that of the white.

        Black is taken off all four. 1 where channels do not disturb each other, which the model
        takes for granted.
        """
        s = self.samples
        luminance = s.xyz[:, 1] - s.xyz[s.black, 1].mean()
        alone = [luminance[s.ramp(c) & (s.drive[:, c] == 1)].mean() for c in range(3)]
        return float(sum(alone) / luminance[s.white].mean())


def characterise(samples: Samples, name: str = "measured display") -> Characterisation:
    """The display's model and its errors.

    1. Black is the mean of its readings; the matrix' columns are the primaries' less black.
    2. A reading of a ramp, less black, projected on its primary is the channel's linear light;
       between the levels measured it is interpolated monotonically (PCHIP).
    3. Matrix and black are then fitted to all ramps and greys for the least sum of squared
       CIEDE2000, begun at 1: real displays are not quite additive, and the eye is to say where
       the error goes. The curves are taken anew with each trial.

    samples  as `read` or `check` lets them pass
    """
    from scipy.optimize import least_squares

    white_y = float(samples.xyz[samples.white, 1].mean())
    relative = Samples(samples.drive, samples.xyz / white_y, samples.full)
    white = relative.xyz[relative.white].mean(axis=0)
    black = relative.xyz[relative.black].mean(axis=0)
    full = [relative.xyz[relative.ramp(c) & (relative.drive[:, c] == 1)] for c in range(3)]
    start = np.stack([reading.mean(axis=0) - black for reading in full], axis=1)
    use = ~relative.mixed
    told = lab(relative.xyz[use], white)

    def residuals(parameters):
        model = _Model.of(parameters[:9].reshape(3, 3), parameters[9:], relative)
        shown = lab(model.xyz(relative.drive[use]), white)
        return delta_e_2000_parts(told, shown).ravel()

    first = np.concatenate([start.ravel(), black])
    # Steps of a ten-thousandth of the white: CIEDE2000 has a kink where colours are equal, and a
    # model that is exact begins there.
    scale = np.concatenate([np.repeat(white, 3), np.maximum(black, 1e-4 * white)])
    found = least_squares(residuals, first, x_scale=scale, diff_step=1e-4, max_nfev=30)
    best = found.x if found.cost < 0.5 * np.sum(residuals(first) ** 2) else first
    model = _Model.of(best[:9].reshape(3, 3), np.maximum(best[9:], 0.0), relative)
    display = model.display(name, white_y)

    def errors(shown, which) -> Errors:
        difference = delta_e_2000(lab(relative.xyz[which], white), lab(shown[which], white))
        if not len(difference):
            return Errors(float("nan"), float("nan"), 0)
        worst = relative.drive[which][np.argmax(difference)]
        return Errors(
            float(difference.mean()),
            float(difference.max()),
            len(difference),
            tuple(map(float, worst)),
        )

    forward = display.xyz(relative.drive)
    there_and_back = display.xyz(display.signal(relative.xyz))
    everything = np.ones(len(relative.drive), bool)
    return Characterisation(
        display,
        fitted=errors(forward, use),
        left_out=errors(forward, relative.mixed),
        inverse=errors(there_and_back, everything),
        samples=samples,
    )


@dataclass(frozen=True)
class _Model:
    """Matrix (3, 3), black (3,), and the curves' drive levels and light, a pair a channel."""

    matrix: Array
    black: Array
    curves: tuple[tuple[Array, Array], ...]

    @classmethod
    def of(cls, matrix, black, samples: Samples) -> _Model:
        return cls(matrix, black, tuple(_curve(matrix, black, samples, c) for c in range(3)))

    def linear(self, drive) -> Array:
        columns = [np.interp(drive[..., c], *self.curves[c]) for c in range(3)]
        return np.stack(columns, axis=-1)

    def drive(self, linear) -> Array:
        columns = [np.interp(linear[..., c], *self.curves[c][::-1]) for c in range(3)]
        return np.stack(columns, axis=-1)

    def xyz(self, drive) -> Array:
        return np.asarray(self.linear(drive) @ self.matrix.T + self.black)

    def display(self, name: str, white_cd_m2: float) -> Display:
        return Display(
            name,
            self.matrix,
            encoded=self.drive,
            decoded=self.linear,
            white_cd_m2=white_cd_m2,
            black=self.black,
        )


def _curve(matrix, black, samples: Samples, channel: int) -> tuple[Array, Array]:
    """Drive levels and linear light (n,) of a channel, from 0, 0 to 1, 1, fine enough to join."""
    from scipy.interpolate import PchipInterpolator

    ramp = samples.ramp(channel)
    primary = matrix[:, channel]
    light = (samples.xyz[ramp] - black) @ primary / (primary @ primary)
    drive, place = np.unique(samples.drive[ramp, channel], return_inverse=True)
    mean = np.bincount(place, light) / np.bincount(place)
    mean[0] = 0.0
    rising = np.maximum.accumulate(np.maximum(mean / mean[-1], 0.0))
    fine = np.linspace(0.0, 1.0, _STEPS)
    values = np.clip(PchipInterpolator(drive, rising)(fine), 0.0, 1.0)
    return fine, np.maximum.accumulate(values)


# --------------------------------------------------------------------------------------- reading


def load(path: str | Path) -> Characterisation:
    """A display's model from a CSV of measurements; InputError with every problem found."""
    path = Path(path)
    return characterise(read(path), path.stem)


def read(path: str | Path) -> Samples:
    """The measurements in a CSV, checked; InputError with every problem found, naming the file."""
    path = Path(path)
    try:
        if not path.is_file():
            raise fault("no such file", f"a CSV with {','.join(COLUMNS)}", "check the path")
        try:
            text = read_text(path, "a CSV of readings")
        except UnicodeDecodeError as error:
            raise fault(
                f"byte {error.start} is not UTF-8", "UTF-8 text", "save it as CSV UTF-8"
            ) from None
        return check(_table(text))
    except InputError as error:
        raise error.at(path) from None


def check(table) -> Samples:
    """Rows (n, 6) of R, G, B, X, Y, Z as Samples; InputError with every problem found."""
    table = np.asarray(table, np.float64)
    drive, xyz = table[:, :3], table[:, 3:]
    problems: list[Problem] = []
    if not np.isfinite(table).all() or (drive < 0).any():
        problems.append(
            Problem("values that are not finite or drives below 0", "numbers", "correct them")
        )
    elif drive.max() <= 0:
        problems.append(Problem("no drive above 0", "ramps of red, green and blue", "measure them"))
    if problems:
        raise InputError(problems)
    samples = Samples(drive / drive.max(), xyz, float(drive.max()))
    problems += _level_problems(samples, float(drive.max()))
    problems += _reading_problems(samples)
    if not problems:
        problems += _ramp_problems(samples, float(drive.max()))
    if problems:
        raise InputError(problems)
    return samples


def _table(text: str) -> Array:
    lines = [
        (number, [cell.strip() for cell in cells])
        for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1)
        if any(cell.strip() for cell in cells)
    ]
    header = tuple(lines[0][1]) if lines else ()
    missing = [name for name in COLUMNS if header.count(name) != 1]
    if missing:
        raise fault(
            f"the columns {', '.join(header) or 'of an empty file'}"[:200],
            f"{','.join(COLUMNS)}, each once: drive levels and tristimulus values",
            f"name or add {', '.join(missing)}",
        )
    order = [header.index(name) for name in COLUMNS]
    rows, problems = [], []
    for number, cells in lines[1:]:
        row = []
        for name, place in zip(COLUMNS, order, strict=True):
            cell = cells[place] if place < len(cells) else ""
            try:
                row.append(float(cell))
            except ValueError:
                found = f"line {number}, column {name!r}: {cell!r}" if cell else "an empty cell"
                problems.append(Problem(found, "a number", "correct or measure it"))
        rows.append(row)
    if not rows:
        problems.append(Problem("no measurements", "a row a colour", "measure some"))
    if problems:
        more = len(problems) - _MOST_PROBLEMS
        if more > 0:
            problems[_MOST_PROBLEMS:] = [Problem(f"{more} more such cells", "", "mend them too")]
        raise InputError(problems)
    return np.array(rows)


def _level_problems(samples: Samples, full: float) -> Iterator[Problem]:
    """What is missing of the drives; `full` is the greatest level in the file."""
    if not samples.black.any():
        yield Problem(
            "no measurement of black (R = G = B = 0)",
            "the screen without signal: its light is in every other reading",
            "measure it and add the row",
        )
    if not samples.white.any():
        yield Problem(
            f"no measurement of the white (R = G = B = {full:g})",
            "the white at full drive",
            "measure it and add the row",
        )
    for channel, name in enumerate(_CHANNELS):
        levels = np.unique(samples.drive[samples.ramp(channel), channel])
        if not (levels == 1).any():
            yield Problem(
                f"{name} alone is not measured at full drive ({full:g})",
                "each primary at full drive, the others 0",
                "measure it, or correct a level that exceeds full drive",
            )
        if len(levels) < LEVELS:
            yield Problem(
                f"a ramp of {name} with {len(levels)} levels",
                f"{LEVELS} or more, black and full drive among them; 9 to 18 are common",
                "measure the channel alone at more levels",
            )


def _reading_problems(samples: Samples) -> Iterator[Problem]:
    """What the readings cannot mean."""
    if (samples.xyz < 0).any():
        row = int(np.argmax((samples.xyz < 0).any(axis=1)))
        yield Problem(
            f"a negative tristimulus value: {samples.xyz[row].min():g} in measurement {row + 1}",
            "X, Y, Z of light",
            "correct the instrument's zero and measure again",
        )
        return
    if not (samples.white.any() and samples.black.any()):
        return
    white = samples.xyz[samples.white].mean(axis=0)
    black = samples.xyz[samples.black].mean(axis=0)
    brightest = samples.xyz[:, 1].max()
    if white[1] < 0.98 * brightest:
        yield Problem(
            f"Y = {brightest:g} of another colour exceeds the white's {white[1]:g}",
            "the white brightest of all",
            "check the order of the columns; switch off dynamic contrast and measure again",
        )
    elif black[1] > 0.2 * white[1]:
        yield Problem(
            f"black at {black[1] / white[1]:.0%} of the white",
            "little light without signal",
            "darken the room, or check that these are R,G,B,X,Y,Z and not x,y,Y",
        )
    x, y = white[:2] / white.sum()
    if not (0.2 < x < 0.5 and 0.2 < y < 0.5):
        yield Problem(
            f"a white of chromaticity x = {x:.3f}, y = {y:.3f}",
            "a white",
            "check that the columns are X, Y, Z in this order and in one unit",
        )


def _ramp_problems(samples: Samples, full: float) -> Iterator[Problem]:
    """Channels whose light falls as their drive rises, and channels that are one colour."""
    black = samples.xyz[samples.black].mean(axis=0)
    primaries = []
    for channel, name in enumerate(_CHANNELS):
        ramp = samples.ramp(channel)
        drive, xyz = samples.drive[ramp, channel], samples.xyz[ramp] - black
        primary = xyz[drive == 1].mean(axis=0)
        primaries.append(primary / max(np.linalg.norm(primary), 1e-12))
        levels, place = np.unique(drive, return_inverse=True)
        light = np.bincount(place, xyz @ primary) / np.bincount(place) / (primary @ primary + 1e-30)
        fall = np.maximum.accumulate(light) - light
        worst = int(np.argmax(fall))
        if fall[worst] > _NOISE:
            yield Problem(
                f"{name} at {levels[worst] * full:g} gives {fall[worst]:.1%} of its full light "
                "less than at a lower level",
                "light that rises with the drive",
                "measure that level again; switch off dynamic contrast",
            )
    if not abs(np.linalg.det(np.stack(primaries))) > 1e-3:
        yield Problem(
            "red, green and blue that are not three different colours",
            "three primaries",
            "check the drive columns R, G, B",
        )
