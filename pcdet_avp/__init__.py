"""Infrastructure-assisted collaborative perception for automated valet parking.

Importing this package costs nothing: no torch, no compiled code, no files read.
"""

__version__ = "0.1.0"
