"""Received maps of several roadside units, sorted for whoever fuses them."""

from __future__ import annotations

from collections.abc import Collection

from pcdet_avp.errors import LinkError
from pcdet_avp.link.packet import LatentMap


def by_source(maps: Collection[LatentMap]) -> dict[str, list[LatentMap]]:
    """Maps of each roadside source, by their senders' numbers; LinkError where a unit has two of one source."""
    found: dict[str, list[LatentMap]] = {}
    for known in sorted(maps, key=lambda known: (known.stamp.modality, known.stamp.sender)):
        of_units = found.setdefault(f"infra_{known.stamp.modality}", [])
        if of_units and of_units[-1].stamp.sender == known.stamp.sender:
            raise LinkError(f"unit {known.stamp.sender}: two {known.stamp.modality} maps at once, expected its newest")
        of_units.append(known)
    return found
