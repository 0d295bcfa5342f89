"""MCAP files with Foxglove's schemas, which Foxglove and Rerun show."""
