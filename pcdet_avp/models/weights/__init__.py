"""Reading, checking and converting trained weights."""
