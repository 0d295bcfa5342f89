"""Back end: from measurements in metres to one consistent trajectory. Imports nothing here, by design."""
