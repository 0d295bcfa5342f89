"""Reports for a person: results and accuracy of a flight's map in one offline page."""
