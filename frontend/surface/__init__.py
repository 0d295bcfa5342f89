"""Surface of the ground from placed pictures: misregistration over the map, relief, dense heights."""
