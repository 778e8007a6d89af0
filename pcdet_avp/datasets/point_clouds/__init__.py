"""Point clouds in the files of the field (README.md here): ``.bin``, ``.npy``, PCD and PLY."""
