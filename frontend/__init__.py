"""Front end: from pixels to relative poses with covariance, loops and mosaics."""
