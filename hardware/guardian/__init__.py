"""Who alone owns the port of a relay board, and lets it heat only while somebody is there."""
