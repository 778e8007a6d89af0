"""``make run``: every part of the system once, on the embedded garage, and a page of what came out.

``steps`` says what is run and what the page shows of it, ``tables``, ``pictures`` and ``summary`` read the results,
``page`` puts them together.
"""
