"""The results of a placement study: placement.json, and index.html for an operator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.files import write_json, write_text
from pcdet_avp.placement.figures import front_figure, heat_map, units_figure
from pcdet_avp.placement.front import Option, Placement, Sight, Solved
from pcdet_avp.placement.pictures import furnished_world, picture
from pcdet_avp.placement.safe_speed import SafeSpeed
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.visualization.page import Comparison, Page, Picture, Section, Table, render
from pcdet_avp.visualization.video import write_picture

Speeds = Mapping[Placement, tuple[SafeSpeed, SafeSpeed]]  # all sensors, one dead
KIND = {"C": "camera", "L": "LiDAR", "CL": "camera and LiDAR"}


def results(
    meta: dict[str, Any], sight: Sight, kept: Sequence[Placement], solved: Sequence[Solved], speeds: Speeds
) -> dict[str, Any]:
    """The content of placement.json. Lengths in metres, angles in degrees, money in euro, shares from 0 to 1."""
    return {
        "meta": meta,
        "floor": sight.site.floor.name,
        "ceiling_m": sight.site.floor.ceiling_m,
        "candidates": len(sight.site.mounts),
        "looks": len(sight.looks),
        "spots": len(sight.site.spots.spots),
        "passes": len(sight.site.spots.passes),
        "occupancies": len(sight.hidden),
        "hidden_share": _hidden_share(sight),
        "solved": [_solved(each) for each in solved],
        "front": [_member(sight, placement, speeds.get(placement)) for placement in kept],
    }


def _hidden_share(sight: Sight) -> float:
    real = np.isfinite(sight.site.ego[..., 0])
    return float(sight.hidden[:, real].mean())


def _solved(each: Solved) -> dict[str, Any]:
    answer = each.answer
    values = {"greedy": answer.greedy, "best": answer.best, "bound": answer.bound, "gap": answer.gap}
    return {"sensors": each.family, "units": each.units, **values, "method": answer.method}


def _member(sight: Sight, placement: Placement, speeds: tuple[SafeSpeed, SafeSpeed] | None) -> dict[str, Any]:
    dead = placement.dead and {"unit": f"U{placement.dead[0] + 1}", "sensor": KIND[placement.dead[1]]}
    return {
        "cost": placement.cost,
        "coverage": placement.share,
        "coverage_worst_occupancy": placement.worst,
        "coverage_one_dead": placement.one_dead,
        "dead": dead,
        "safe_speed": speeds and speeds[0].mps,
        "safe_speed_one_dead": speeds and speeds[1].mps,
        "unfinished": speeds and speeds[0].unfinished,
        "unfinished_one_dead": speeds and speeds[1].unfinished,
        "bytes_per_s": sum(sight.models.bytes_per_s(option.sensors) for option in placement.options),
        "units": unit_entries(sight, placement.options),
    }


def unit_entries(sight: Sight, options: Sequence[Option]) -> list[dict[str, Any]]:
    """The roadside units of some options as in placement.json: metres, degrees, the plan's frame."""
    return [_unit(sight, *each) for each in zip(options, sight.units(options), strict=True)]


def _unit(sight: Sight, option: Option, unit: MountedUnit) -> dict[str, Any]:
    mount = sight.site.mounts[sight.looks[option.look].mount]
    angles = {
        "yaw_deg": float(np.degrees(unit.yaw_rad) % 360),
        "pitch_down_deg": float(np.degrees(unit.pitch_down_rad)),
    }
    place = {"x_m": unit.x_m, "y_m": unit.y_m, "height_m": unit.z_m}
    values = {**place, **angles}
    return {
        "id": unit.id,
        "mount": mount.id,
        "on": mount.on,
        **{key: round(value, 3) for key, value in values.items()},
        "sensors": option.sensors,
        "price": sight.models.price(option.sensors),
    }


def recommended(kept: Sequence[Placement], speeds: Speeds) -> Placement:
    """The cheapest placement of those driven with the highest safe speed; where none was driven, or all crashed at the
    slowest speed, the first that comes within a twentieth of the best coverage."""
    fastest = max((whole.mps for whole, _ in speeds.values()), default=0.0)
    if fastest > 0:
        return min((p for p in speeds if speeds[p][0].mps == fastest), key=lambda p: p.cost)
    best = max(p.share for p in kept)
    return next(p for p in kept if p.share >= 0.95 * best)


def write_report(
    out: Path,
    content: dict[str, Any],
    sight: Sight,
    placements: Sequence[Placement],
    kept: Sequence[Placement],
    speeds: Speeds,
) -> Path:
    """Write placement.json and index.html with its pictures; the page's path."""
    write_json(out / "placement.json", content)
    chosen = recommended(kept, speeds)
    page = _page(out / "figures", content, sight, placements, kept, speeds, chosen)
    write_text(out / "index.html", render(page))
    return out / "index.html"


def _page(folder: Path, content, sight: Sight, placements, kept, speeds: Speeds, chosen: Placement) -> Page:
    units, none = sight.units(chosen.options), np.zeros(sight.weights.shape, bool)
    before = heat_map(sight, none, (), "The driving car alone", folder / "blind_before.png")
    after = heat_map(sight, sight.covered(chosen.options), units, "With the units", folder / "blind_after.png")
    front_file = front_figure(placements, kept, dict(speeds), folder / "front.png")
    where = units_figure(sight, units, "Chosen units among all candidate places", folder / "units.png")
    name, floor = content["meta"]["plan_name"], sight.site.floor
    member = next(m for m in content["front"] if m["cost"] == chosen.cost and m["coverage"] == chosen.share)
    return Page(
        title=f"Where the sensors go: {name}",
        subtitle=f"Floor {floor.name}, ceiling {floor.ceiling_m:g} m, {len(floor.slots)} slots, "
        f"{content['candidates']} candidate places, {content['spots']} spots, {content['occupancies']} occupancies",
        summary=_summary(content, member, speeds, chosen),
        comparisons=_comparisons(content, member, speeds, kept, chosen),
        lead=[_plot(front_file, "Cost of a placement against what it covers", _front_caption(speeds))],
        sections=[
            _blind_section(before, after),
            _units_section(folder, where, sight, units),
            _table_section(content, member),
            Section("All placements of the front", parts=[_front_table(content)]),
            _method_section(content),
        ],
        about={key: str(value) for key, value in content["meta"].items() if key in ABOUT},
    )


ABOUT = ("command", "plan_name", "seed", "git_commit", "wall_time_s")


def _summary(content, member, speeds: Speeds, chosen: Placement) -> str:
    count = len(member["units"])
    units = f"{count} roadside unit{'s' if count != 1 else ''}"
    drives = "" if chosen not in speeds else f" {_safe(speeds[chosen][0])}"
    return (
        f"In {100 * content['hidden_share']:.0f} % of the moments looked at, the driving car cannot see the road user "
        f"who might come out. {units} for {member['cost']:,.0f} euro cover **{100 * member['coverage']:.0f} %** of "
        f"these moments, {100 * member['coverage_worst_occupancy']:.0f} % in the worst occupancy.{drives}"
    )


def _safe(safe: SafeSpeed) -> str:
    if not safe.mps:
        return "With them a drive crashed even at the slowest speed."
    cut_off = f"; {safe.unfinished} of these drives did not finish in time" if safe.unfinished else ""
    return f"With them no drive crashed up to **{safe.mps:g} m/s**{cut_off}."


def _shown(safe: SafeSpeed, unit: str = " m/s") -> str:
    return f"{safe.mps:g}{unit}" + (f" ({safe.unfinished} unfinished)" if safe.unfinished else "")


def _comparisons(content, member, speeds: Speeds, kept, chosen: Placement) -> list[Comparison]:
    share = content["hidden_share"]
    left = share * (1 - member["coverage"])
    shown = [Comparison("Moments in which a road user is hidden", f"{100 * share:.1f} %", f"{100 * left:.1f} %")]
    nobody = next((p for p in kept if not p.options), None)
    if nobody in speeds and chosen in speeds:
        remark = f"{_shown(speeds[chosen][1])} with one sensor dead; line of sight"
        shown.append(Comparison("Safe speed", _shown(speeds[nobody][0]), _shown(speeds[chosen][0]), remark))
    return shown


def _plot(file: Path, alt: str, caption: str) -> Picture:
    return Picture(file, alt, caption, is_plot=True)


def _front_caption(speeds: Speeds) -> str:
    driven = "Below: the highest speed up to which no drive of the closed loop crashed." if speeds else ""
    return f"Above: share of the hidden moments that a placement covers; no cheaper one covers more. {driven}"


def _blind_section(before: Path, after: Path) -> Section:
    text = (
        "Lanes: how many road users are hidden, on average, where they would come out at that metre. Slots: in what "
        "share of the moments somebody beside the slot is hidden. The ground's colour means none."
    )
    parts = [
        _plot(before, "Heat map of blind spots without roadside units", "Hidden from the driving car."),
        _plot(after, "Heat map of blind spots with the chosen units", "Hidden from the car and from every unit."),
    ]
    return Section("Blind spots per metre of lane and per slot", text, parts=parts)


def _units_section(folder: Path, where: Path, sight: Sight, units: Sequence[MountedUnit]) -> Section:
    parts = [_plot(where, "Plan with the chosen units", "Dots: candidate places. Wedges: where the chosen units look.")]
    world = furnished_world(sight.site.floor) if units else None
    for unit in units:
        file = folder / f"{unit.id}.png"
        write_picture(file, picture(world, unit, sight.models))
        caption = (
            f"**{unit.id}** at ({unit.x_m:.1f}, {unit.y_m:.1f}) m, {unit.z_m:.2f} m high: what a camera there sees."
        )
        parts.append(Picture(file, f"View of unit {unit.id}", caption))
    return Section("The chosen units", parts=parts)


def _table_section(content, member) -> Section:
    head = "| unit | x (m) | y (m) | height (m) | looks to (deg) | down (deg) | hangs on | sensors | price (euro) |"
    lines = [head, "|---|---|---|---|---|---|---|---|---|"]
    for unit in member["units"]:
        place = " | ".join(f"{unit[key]:.2f}" for key in ("x_m", "y_m", "height_m"))
        angles = " | ".join(f"{round(unit[key], 1):g}" for key in ("yaw_deg", "pitch_down_deg"))
        what = f"{unit['on']} ({unit['mount']}) | {KIND[unit['sensors']]} | {unit['price']:,.0f}"
        lines.append(f"| {unit['id']} | {place} | {angles} | {what} |")
    rate = 8 * member["bytes_per_s"] / 1e6
    caption = (
        f"To hand to an installer: x and y as in the plan, directions counter-clockwise from +x. Together "
        f"{member['cost']:,.0f} euro and {rate:.1f} Mbit/s on the air."
    )
    return Section("Installation", parts=[Table(caption, lines)])


def _front_table(content) -> Table:
    head = "| units | cost (euro) | covered | worst occupancy | one dead | safe speed (m/s) | one dead (m/s) | Mbit/s |"
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for member in content["front"]:
        units = ", ".join(unit["sensors"] for unit in member["units"]) or "none"
        speed, dead = (_driven(member[f"safe_speed{of}"], member[f"unfinished{of}"]) for of in ("", "_one_dead"))
        shares = [f"{100 * member[key]:.1f} %" for key in ("coverage", "coverage_worst_occupancy", "coverage_one_dead")]
        rate = 8 * member["bytes_per_s"] / 1e6
        lines.append(f"| {units} | {member['cost']:,.0f} | {' | '.join(shares)} | {speed} | {dead} | {rate:.1f} |")
    return Table(
        "C: camera, L: LiDAR. Prices are those of cfgs/placement.yaml. Unfinished: drives up to that speed which the "
        "time limit cut off; they are no crashes.",
        lines,
    )


def _driven(speed: float | None, unfinished: int | None) -> str:
    return "" if speed is None else _shown(SafeSpeed(speed, unfinished), unit="")


def _method_section(content) -> Section:
    lines = ["| sensors | units | greedy | best found | bound | gap | found by |", "|---|---|---|---|---|---|---|"]
    for each in content["solved"]:
        values = " | ".join(f"{100 * each[key]:.1f} %" for key in ("greedy", "best", "bound", "gap"))
        lines.append(f"| {each['sensors']} | {each['units']} | {values} | {each['method']} |")
    text = (
        "A line of sight is free if a ray to the road user's body meets neither building nor parked car. Sensors count "
        "what a body covers of their image or beams. No placement of so many units can cover more than the bound."
    )
    return Section("How good the choice is", text, parts=[Table("Share of the hidden moments covered.", lines)])
