"""Work of the front end that an earlier run did, found by all that its results depend on."""
