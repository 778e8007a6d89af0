"""Episodes in people's tools: a page to scrub, MCAP, Rerun, OpenSCENARIO with OpenDRIVE, CommonRoad."""
