"""Videos: pictures with exact times, and the readings in their subtitles and metadata."""
