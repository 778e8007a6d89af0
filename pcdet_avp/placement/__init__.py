"""Where the sensors of a garage should hang: what each place sees, the choice, and how fast a car may then drive.

Rooms, from the ground up: ``sensors`` (models and prices), ``spots`` (where road users hide), ``candidates`` (where
sensors may hang), ``visibility`` (who sees what, by ray tracing), ``choice`` (greedy, local search, MILP), ``front``
(cost against coverage), ``safe_speed`` (the closed loop), ``study`` (all of it on Dask), ``report`` (the page). A
placement is a tuple of ``structures.roadside_unit.MountedUnit``.
"""
