"""Pictures of the report: maps, paths and heights."""
