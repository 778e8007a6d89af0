"""Where the sensors of a garage's plan should hang: what each place sees, the choice, and how fast a car may then drive.

Rooms, from the ground up: ``spots`` (where road users hide), ``candidates`` (where sensors may hang, what they cost),
``visibility`` (who sees what, by ray tracing), ``choice`` (greedy, local search, MILP), ``front`` (cost against coverage),
``safe_speed`` (the closed loop), ``page`` (the report). A placement is a tuple of ``plans.floor.Unit``.
"""
