"""Which edges to believe where they contradict each other: see `backend.pose_graph.selection.rejection`."""
