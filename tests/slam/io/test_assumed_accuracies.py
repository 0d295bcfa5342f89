"""Which accuracies of a flight folder are stated, and which are assumed."""

from __future__ import annotations

import numpy as np

from slam.core.flight import Flight, Sonar, Velocity
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight


def test_what_sensor_yaml_does_not_state_is_assumed(tmp_path):
    stamps_s = np.arange(5.0)
    flight = Flight("made", sonar=Sonar(stamps_s, np.ones(5)), velocity=Velocity(stamps_s, np.zeros((5, 2))))
    write_flight(flight, tmp_path / "whole")
    assert read_flight(tmp_path / "whole").sonar.assumed == ()
    path = tmp_path / "whole" / "mav0" / "sonar0" / "sensor.yaml"
    kept = [line for line in path.read_text().splitlines() if not line.startswith("scale_std")]
    path.write_text("\n".join(kept))
    assert read_flight(tmp_path / "whole").sonar.assumed == ("scale_std",)
    path.unlink()
    read = read_flight(tmp_path / "whole")
    assert read.sonar.assumed == ("noise_std", "scale_std", "datum_std")
    assert read.velocity.assumed == ()


def test_an_import_remembers_what_it_has_assumed(tmp_path):
    sonar = Sonar(np.arange(5.0), np.ones(5), assumed=("noise_std", "datum_std"))
    write_flight(Flight("made", sonar=sonar), tmp_path / "imported")
    assert read_flight(tmp_path / "imported").sonar.assumed == ("noise_std", "datum_std")
