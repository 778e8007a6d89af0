"""One-cycle training with a random sensor combination per iteration."""
