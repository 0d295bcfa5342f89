"""Tables of the report for an engineer."""
