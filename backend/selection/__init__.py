"""Which edges to believe where they contradict each other: see `backend.selection.rejection`."""
