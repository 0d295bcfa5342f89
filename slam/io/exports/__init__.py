"""Files of a map for other programs: one module for each format, and one row of ``formats.FORMATS``."""
