"""Measures of safety and comfort that users of AVP evaluations ask for, from an episode's motion alone."""
