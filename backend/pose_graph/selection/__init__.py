"""Selection of consistent edges among contradictory ones: see `backend.pose_graph.selection.rejection`."""
