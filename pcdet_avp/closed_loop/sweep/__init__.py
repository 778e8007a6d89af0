"""Many episodes: cases, the search for the edge of safety, the journal, crash statistics."""
