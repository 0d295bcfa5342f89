"""Which accuracies of a flight folder are stated, and which are assumed."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Gps, Sonar, Velocity
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


def test_an_antenna_told_at_the_origin_of_the_body_is_no_untold_one(tmp_path):
    t = np.arange(5.0)
    gps = Gps(t, np.full(5, 47.0), np.full(5, 8.0), np.full(5, 400.0))
    write_flight(Flight("told", gps=gps), tmp_path / "told")
    assert not read_flight(tmp_path / "told").gps.antenna_assumed
    untold = Gps(*(gps.stamps_s, gps.latitude_deg, gps.longitude_deg, gps.altitude_m), assumed=("T_BS",))
    write_flight(Flight("untold", gps=untold), tmp_path / "untold")
    assert read_flight(tmp_path / "untold").gps.antenna_assumed
    path = tmp_path / "told" / "mav0" / "gps0" / "sensor.yaml"
    kept = path.read_text().split("T_BS")[0] + "rate_hz: 1\nnoise_std: [1e-5, 1e-5, 2]\n"
    path.write_text(kept)
    assert read_flight(tmp_path / "told").gps.assumed == ("T_BS",)


@pytest.mark.parametrize("value", ["noise_std", "7", "{noise_std: 1}", "[[noise_std]]"])
def test_what_is_no_list_of_keys_is_refused(tmp_path, value):
    write_flight(Flight("made", sonar=Sonar(np.arange(5.0), np.ones(5))), tmp_path / "f")
    path = tmp_path / "f" / "mav0" / "sonar0" / "sensor.yaml"
    path.write_text(f"{path.read_text()}assumed: {value}\n")
    with pytest.raises(InputError, match=r"sonar0/sensor\.yaml, line .*assumed is not a list of plain texts"):
        read_flight(tmp_path / "f")
