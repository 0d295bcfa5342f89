"""MCAP recordings with Foxglove's schemas, in JSON or protobuf."""
