"""The rows of slots, cut at their pillars."""

from __future__ import annotations

from pcdet_avp.sim.garage import GarageLayout, Slot


def bays_on_the_right(layout: GarageLayout) -> list[list[Slot]]:
    """The ego's right row, cut at its pillars: slots by x in each bay, the bay nearest to the junction first."""
    followed_by = dict(layout.neighbours())
    right = sorted((slot for slot in layout.slots if slot.y < 0), key=lambda slot: slot.x)
    bays: list[list[Slot]] = []
    for slot in right:
        if not (bays and followed_by.get(bays[-1][-1]) == slot):
            bays.append([])
        bays[-1].append(slot)
    return bays[::-1]
