"""Registration of received maps against the vehicle's own: where the vehicle really is, beside where it believes to be.

A vehicle without GNSS places the roadside's maps by a pose that is off by decimetres and degrees. Both sides see the
same walls, pillars and parked cars, so the maps themselves tell the error (the paper's introduction names this use of
BEV maps). Nothing here is trained, and nothing imports torch: the same code serves every runtime.
"""

from pcdet_avp.registration.registrar import Correction, Registrar
from pcdet_avp.registration.settings import RegistrationSettings
from pcdet_avp.registration.steady import SteadyCorrection

__all__ = ["Correction", "Registrar", "RegistrationSettings", "SteadyCorrection"]
