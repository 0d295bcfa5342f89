"""Where a simulated flight takes place: floors, marks, obstacles and what moves among them."""
