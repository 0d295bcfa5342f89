"""From pictures and instruments to one map: keyframes, edges between them, parts placed and joined."""
