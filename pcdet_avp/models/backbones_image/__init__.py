"""The camera's half: image features, depth bins, the categorical depth distribution and its loss (CaDDN, section 3)."""
