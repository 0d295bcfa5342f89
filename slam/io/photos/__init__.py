"""Photo sets: finding the photographs, their tags, cameras and positions."""
