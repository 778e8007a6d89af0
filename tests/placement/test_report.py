"""What an installer reads."""

from pcdet_avp.placement.report import _table_section


def test_directions_are_told_to_a_tenth_of_a_degree():
    """A mount may name ways to look that lie less than a degree apart."""
    place = {"x_m": 1.0, "y_m": 2.0, "height_m": 2.8, "on": "wall", "mount": "w", "sensors": "C", "price": 400.0}
    units = [{"id": "U1", "yaw_deg": 180.4, "pitch_down_deg": 10.0, **place}]
    (table,) = _table_section({}, {"units": units, "bytes_per_s": 0.0, "cost": 400.0}).parts
    assert "| 180.4 | 10 |" in table.lines[-1]
