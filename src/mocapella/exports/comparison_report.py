"""Report of a comparison with a reference: as text, as JSON, as figures, as a table of curves, and as an HTML page."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from mocapella.comparison.agreement import LIMIT, LimitsOfAgreement, agreement
from mocapella.comparison.comparison import STATES, Compared
from mocapella.exports.needs import needed
from mocapella.model.names import as_cell

_MOST_ANGLES: Final = 6
"""Number of angles whose curves are drawn."""
TIME_ONLY: Final = "time corrected only, files' own coordinates"
RIGID: Final = "time and rigid motion corrected"
SAME_SPACE: Final = "same coordinates, no rigid motion"
POSITION_HEADS: Final = ("", "n", "mean mm", "SD mm", "RMSE mm", "bias x, y, z mm", "95 % limits x, y, z mm")
ANGLE_HEADS: Final = ("", "n", "mean °", "SD °", "RMSE °", "bias °", "95 % limits °")
LEFT_OUT_FIRST: Final = ("95 %", "bias", "SD", "mean", "n")
"""Beginnings of the columns that a narrow terminal leaves out, in their order."""
CURVES: Final = (
    "time_s", "reference_s", "individual", "joint", "state", "dx_m", "dy_m", "dz_m", "time_only_m", "rigid_m",
)  # fmt: skip
"""Columns of the table of curves: dx, dy, dz are the differences after all corrections; the two distances are with the
time corrected only, and with time and rigid motion, before a bias is removed."""


def rigid_words(one: Compared) -> str:
    """Return the words for the position errors after all corrections."""
    words = RIGID if not one.motion.space_held else SAME_SPACE
    return f"{words}, mean difference of each joint removed" if one.bias_removed else words


def position_words(one: Compared) -> str:
    """Return what the rows of the table of positions are."""
    return f"Time only: {TIME_ONLY}. Other rows: {rigid_words(one)}."


def fitting(heads: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[int]:
    """Return the columns of a table that fit side by side into a width, by leaving out `LEFT_OUT_FIRST`.

    Args:
        heads, rows: texts of the table.
        width: number of characters; two are between columns.
    """
    sizes = [max(map(len, column)) + 2 for column in zip(heads, *rows, strict=True)]
    kept = list(range(len(heads)))
    for word in LEFT_OUT_FIRST:
        if sum(sizes[k] for k in kept) <= width:
            break
        kept = [k for k in kept if not heads[k].startswith(word)]
    return kept


def findings(one: Compared) -> list[str]:
    """Return the joints, estimates and corrections, a sentence each."""
    motion = one.motion
    lines = [
        f"compared: {len(one.joints)} joints of {', '.join(f'{a} and {b}' for a, b in one.people.items())}, "
        f"{motion.common_s:.1f} s in common",
        f"time: {_time(one)}",
        f"rate: {_rate(one)}",
        f"rigid motion: {_rigid(one)}",
        f"corrections that saw the reference: {'; '.join(one.corrections) or 'none'}",
    ]
    return [*lines, *(f"note: {note}" for note in one.notes)]


def _rigid(one: Compared) -> str:
    motion = one.motion
    if motion.space_held:
        return "held, both are in the same coordinates (--same-space)"
    angle = np.degrees(np.linalg.norm(Rotation.from_matrix(motion.T[:3, :3]).as_rotvec()))
    return (
        f"turned by {angle:.2f} ± {np.degrees(np.linalg.norm(motion.rotation_sd)):.2f}°, shifted by "
        f"({', '.join(f'{x:.4f}' for x in motion.T[:3, 3])}) m, the joints' centre ± "
        f"{1e3 * np.linalg.norm(motion.translation_sd_m):.1f} mm"
    )


def _time(one: Compared) -> str:
    motion, unit = one.motion, "s" if one.clock else "frames"
    if motion.clock_held:
        return "held, both have one clock (--same-clock)"
    sure = f"± {1e3 * motion.offset_sd_s:.2f} ms" if motion.time_observable else "± infinite (not observable)"
    return (
        f"recording {motion.middle_s:.4f} s is reference {motion.reference_middle_s:.4f} {unit} {sure}, in the middle "
        "of the common time"
    )


def _rate(one: Compared) -> str:
    motion = one.motion
    if motion.clock_held:
        return "held at 1"
    if not one.clock:
        return f"the reference has {motion.ratio:.4f} ± {motion.ratio * motion.ratio_sd:.4f} frames a second"
    if not motion.drift_estimated or not math.isfinite(motion.ratio_sd):
        return "taken as stated; the motion in common does not determine the clocks' ratio"
    return f"1 s of the recording is {motion.ratio:.6f} ± {motion.ratio_sd:.6f} s of the reference"


def as_dict(one: Compared) -> dict[str, Any]:
    """Return the comparison as values for JSON: metres, seconds, radians; None where something is not observable."""
    motion = one.motion
    angle_rad = Rotation.from_matrix(motion.T[:3, :3]).as_rotvec()

    def finite(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    def tables(found: Any) -> dict[str, Any]:
        return {name: msgspec.to_builtins(found(state)) for name, state in (("all", None), *((s, s) for s in STATES))}

    return {
        "kind": one.kind,
        "people": dict(one.people),
        "joints": {each.name: {"recording": dict(each.ours), "reference": dict(each.theirs)} for each in one.joints},
        "corrections": list(one.corrections),
        "notes": list(one.notes),
        "common_s": motion.common_s,
        "time": {
            "recording_s": motion.middle_s, "reference": motion.reference_middle_s,
            "unit": "s" if one.clock else "frames", "sd_s": finite(motion.offset_sd_s),
            "observable": motion.time_observable, "held": motion.clock_held,
        },
        "rate": {
            "ratio": motion.ratio, "relative_sd": finite(motion.ratio_sd),
            "estimated": motion.drift_estimated and math.isfinite(motion.ratio_sd),
            "held": motion.clock_held,
        },
        "rigid_motion": {
            "T_recording_reference": motion.T.tolist(), "rotation_rad": angle_rad.tolist(),
            "rotation_sd_rad": motion.rotation_sd.tolist(), "centre_m": motion.centre_m.tolist(),
            "centre_sd_m": motion.translation_sd_m.tolist(), "held": motion.space_held,
        },
        "motion_explained": motion.explained,
        "positions_m": {
            "time_only": {"all joints": tables(lambda s: one.all_positions(s, rigid=False)),
                          "joints": tables(lambda s: one.positions(s, rigid=False))},
            "rigid": {"all joints": tables(one.all_positions), "joints": tables(one.positions),
                      "bias_removed": one.bias_removed},
        },
        "angles_rad": {"all angles": tables(one.all_angles), "angles": tables(one.angle_agreement)},
    }  # fmt: skip


def position_rows(one: Compared) -> list[tuple[str, ...]]:
    """Return the rows of the table of positions, under `POSITION_HEADS`: all joints in both ways, then each joint."""
    rows = [_position("all, time only", one.all_positions(rigid=False))]
    rows.append(_position("all", one.all_positions()))
    rows += [_position(f"all, {state}", one.all_positions(state)) for state in STATES]
    rows += [_position(name, found) for name, found in one.positions().items()]
    return [row for row in rows if row]


def _position(name: str, found: LimitsOfAgreement | None) -> tuple[str, ...]:
    if found is None:
        return ()
    bias = ", ".join(f"{1e3 * x:.1f}" for x in found.bias)
    limits = ", ".join(f"{1e3 * a:.0f} … {1e3 * b:.0f}" for a, b in zip(found.low, found.high, strict=True))
    sizes = (f"{1e3 * x:.1f}" for x in (found.mean, found.sd, found.rmse))
    return (name, str(found.n), *sizes, bias, limits)


def angle_rows(one: Compared) -> list[tuple[str, ...]]:
    """Return the rows of the table of angles, under `ANGLE_HEADS`: all together, then each."""
    rows = [("all", one.all_angles()), *((f"all, {state}", one.all_angles(state)) for state in STATES)]
    rows += one.angle_agreement().items()
    return [_angle(name, found) for name, found in rows if found is not None]


def _angle(name: str, found: LimitsOfAgreement) -> tuple[str, ...]:
    sizes = (f"{math.degrees(x):.2f}" for x in (found.mean, found.sd, found.rmse, found.bias[0]))
    low, high = math.degrees(found.low[0]), math.degrees(found.high[0])
    return (name, str(found.n), *sizes, f"{low:.1f} … {high:.1f}")


def figure_of(one: Compared) -> Any:
    """Return a matplotlib figure: position errors over time, curves of angles, and their differences by the mean.

    Raises:
        SettingsError: matplotlib is not installed; names the extra.
    """
    shown = _most_moving(one)
    high = max(2.4, 0.13 * len(one.joints) * (1 + len(one.people)) / 1.5)
    figure = needed("matplotlib.figure", extra="plots").Figure(
        figsize=(10.0, high + 2.2 * len(shown)), layout="constrained"
    )
    axes = figure.subplots(
        1 + len(shown), 2, squeeze=False, width_ratios=(2, 1), height_ratios=(high, *[2.2] * len(shown))
    )
    _draw_errors(one, *axes[0])
    people = list(one.people)
    for (left, right), (i, k) in zip(axes[1:], shown, strict=True):
        ours, theirs = (np.degrees(side[:, i, k]) for side in (one.angles, one.reference_angles))
        left.plot(one.times_s, theirs, "k-", lw=1, label="reference")
        left.plot(one.times_s, ours, "-", color="tab:orange", lw=1, label="recording")
        left.set_title(f"{people[i]}: {one.angle_names[k]}", fontsize="medium")
        left.set_ylabel("angle [°]")
        left.margins(x=0)
        _draw_limits(right, ours, theirs)
    if shown:
        axes[1, 0].legend(fontsize="small", loc="upper right")
        axes[1, 1].legend(fontsize="small", loc="upper right")
        axes[-1, 1].set_xlabel("mean of both [°]")
    axes[-1, 0].set_xlabel("time of the recording [s]")
    return figure


def _most_moving(one: Compared) -> list[tuple[int, int]]:
    """Return the angles that change most, and have differences: person and angle, alike many of each person."""
    each = max(1, _MOST_ANGLES // len(one.people))
    chosen = []
    for i in range(min(len(one.people), _MOST_ANGLES)):
        change = [
            np.ptp(own[np.isfinite(own)]) if np.isfinite(own).sum() > 2 else -1.0
            for own in one.reference_angles[:, i].T
        ]
        order = [k for k in np.argsort(-np.array(change), kind="stable").tolist() if change[k] >= 0]
        chosen += [(i, k) for k in sorted(order[:each])]
    return chosen


def _draw_errors(one: Compared, left: Any, right: Any) -> None:
    lines = [(one.errors, rigid_words(one))]
    if not one.motion.space_held:
        lines.insert(0, (one.uncorrected, "time corrected only"))
    for errors, label in lines:
        size = 1e3 * np.linalg.norm(errors, axis=3).reshape(len(one.times_s), -1)
        some = np.isfinite(size).any(axis=1)
        left.plot(one.times_s[some], [np.nanmedian(row) for row in size[some]], lw=1, label=label)
    left.set_title("position error, median of all joints", fontsize="medium")
    left.set_ylabel("error [mm]")
    if any(np.nanmax(np.abs(errors), initial=0.0) > 0 for errors, _ in lines):
        left.set_yscale("log")
    left.margins(x=0)
    left.legend(fontsize="small", loc="upper right")
    names = [joint.name for joint in one.joints]
    thick = 0.8 / len(one.people)
    for i, person in enumerate(one.people):
        found = [agreement(one.errors[one.states[:, i, k] > 0, i, k]) for k in range(len(names))]
        at = np.arange(len(names)) + (i - (len(one.people) - 1) / 2) * thick
        right.barh(at, [math.nan if each is None else 1e3 * each.rmse for each in found], thick, label=person)
    right.set_yticks(range(len(names)), names, fontsize="small")
    right.set_ylim(len(names) - 0.5, -0.5)
    right.set_title("RMSE of each joint", fontsize="medium")
    right.set_xlabel("RMSE [mm]")
    if len(one.people) > 1:
        right.margins(x=0.4)
        right.legend(fontsize="small", loc="lower right")


def _draw_limits(axis: Any, ours: Any, theirs: Any) -> None:
    """Draw the differences by the mean, with bias and limits (Bland and Altman, 1986)."""
    difference = (ours - theirs + 180.0) % 360.0 - 180.0
    axis.plot(theirs + difference / 2, difference, ".", ms=1.5, alpha=0.4, rasterized=True)
    found = agreement(difference[:, None])
    if found is not None:
        lines = ((found.bias[0], "-", "bias"), (found.low[0], "--", f"bias ± {LIMIT} SD"), (found.high[0], "--", None))
        for value, style, label in lines:
            axis.axhline(value, color="k", ls=style, lw=0.8, label=label)
    axis.set_title("recording minus reference", fontsize="medium")
    axis.set_ylabel("difference [°]")


def write_curves(one: Compared, path: Path) -> None:
    """Write the differences as a table, a row for each joint of each individual at each time (`CURVES`).

    Raises:
        OSError: the file cannot be written.
    """
    names = {int(value): name for name, value in STATES.items()}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(CURVES)
        rigid = one.errors + one.biases if one.bias_removed else one.errors
        sizes = [np.linalg.norm(errors, axis=3) for errors in (one.uncorrected, rigid)]
        for t, i, k in np.argwhere(one.states > 0).tolist():
            person, joint = list(one.people)[i], one.joints[k].name
            numbers = (*one.errors[t, i, k], sizes[0][t, i, k], sizes[1][t, i, k])
            writer.writerow([
                f"{one.times_s[t]:.6f}", f"{one.reference_s[t]:.6f}", as_cell(person), as_cell(joint),
                names[int(one.states[t, i, k])], *(f"{value:.5f}" for value in numbers),
            ])  # fmt: skip


def write_report(one: Compared, path: Path, titles: Mapping[str, str]) -> None:
    """Write the report as one HTML page with its figure in it.

    Args:
        one: the comparison.
        path: the file.
        titles: names of the files by role, such as ``recording``.

    Raises:
        SettingsError: matplotlib is not installed; names the extra.
        OSError: the file cannot be written.
    """
    picture = io.BytesIO()
    figure_of(one).savefig(picture, format="png", dpi=110)
    path.write_text("\n".join(_page(one, titles, picture.getvalue())) + "\n", encoding="utf-8")


def _page(one: Compared, titles: Mapping[str, str], picture: bytes) -> Iterator[str]:
    title = html.escape(" and ".join(titles.values()))
    yield "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
    yield f"<title>{title}</title><style>body{{font:15px sans-serif;max-width:70em;margin:2em auto}}"
    yield "table{border-collapse:collapse}td,th{padding:.2em .8em;text-align:right}td:first-child{text-align:left}"
    yield "tr:nth-child(even){background:#eee}img{max-width:100%}</style></head><body>"
    yield f"<h1>{title}</h1><ul>"
    yield from (f"<li>{html.escape(role)}: {html.escape(name)}</li>" for role, name in titles.items())
    yield from (f"<li>{html.escape(line)}</li>" for line in findings(one))
    yield "</ul><h2>Positions: recording minus reference</h2>"
    yield f"<p>{html.escape(position_words(one))} Mean, SD and RMSE are of the distance.</p>"
    yield from _table(POSITION_HEADS, position_rows(one))
    yield "<h2>Angles: recording minus reference</h2>"
    yield from _table(ANGLE_HEADS, angle_rows(one))
    yield f"<h2>Curves</h2><img alt='curves' src='data:image/png;base64,{base64.b64encode(picture).decode('ascii')}'>"
    yield "</body></html>"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield "<table><tr>" + "".join(f"<th>{html.escape(head)}</th>" for head in heads) + "</tr>"
    for row in rows:
        yield "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
    yield "</table>"
