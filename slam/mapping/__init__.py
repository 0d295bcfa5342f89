"""From pictures and instruments to one map: pictures seen, edges between them, parts placed and joined."""
