"""Whether the noise of instruments is coloured: healthy, but no model that takes it for white.

Innovations that resemble the ones before may come of noise that does, or of an effect that the belief lacks.
So colour competes with the causes: where it stands out, its correlations are fitted with the nuisances, the
filter run anew, and the belief turns to it where it explains more than the best cause or shape beside it,
and something in every channel of its instrument and in every flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import FilterPass, whole
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, INSTRUMENT_OF, place_of
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.search.information import NoiseChange
from slam.criticism.search.nuisances import AR1_COEFFICIENTS, Nuisance, value_of, with_value
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]

STEP = 0.03
MIN_AR1 = 0.05
"""Less of it makes what is left over look stronger by a twentieth at most: then noise is held to be white."""
STANDS_OUT = 3.0
"""Deviates of the correlation of innovations with the next, in every channel of an instrument."""
LEAD_NATS = 20.0
"""By which colour must explain more than what else there is."""


def ar1_effects(setting: FilterParameters) -> tuple[Effect, ...]:
    """The correlations of the instruments that a belief holds to be coloured, as something to be fitted."""
    return tuple(_effect(n) for n in AR1_COEFFICIENTS if value_of(n, setting) > 0.0)


def with_ar1_noise(
    records: Sequence[Record],
    model: FilterParameters,
    setting: FilterParameters,
    passes: Sequence[FilterPass],
    chosen: Sequence[Effect],
    most_nats: float,
) -> FilterParameters | None:
    """The belief with coloured noise, if that explains more of the flights than anything else.

    ``passes`` are the filter's runs under ``setting``, which holds the ``chosen`` terms; ``most_nats`` is
    what the best other explanation beside these gains. A foreign vehicle's instruments are not looked into.
    """
    correlation, deviate = lag_one_correlation(records, passes)
    seen = [] if model.out_of_model else [n for n in AR1_COEFFICIENTS if _stands_out(n, correlation, deviate)]
    # About half the squared deviates are what it can explain: no fit where even twice that is too little.
    if np.nansum(deviate[[c for n in seen for c in _channels(n)]] ** 2) < most_nats:
        return None
    while seen:
        shaded = fit_nuisances(records, model, setting, [*chosen, *(_effect(n) for n in seen)])
        shaded = without_small_ar1(shaded)
        gained = _gained(records, passes, shaded)
        kept = [n for n in seen if value_of(n, shaded) > 0.0 and _everywhere(gained[:, _channels(n)])]
        if kept == seen:
            break
        seen = kept
    # What the nuisances gain elsewhere, fitted once more, is not the colour's; what they lose is.
    own = [channel for n in seen for channel in _channels(n)]
    if not seen or min(gained[:, own].sum(), gained.sum()) < most_nats + LEAD_NATS:
        return None
    return without_small_ar1(fit_nuisances(records, model, shaded, [*chosen, *ar1_effects(shaded)]))


def without_small_ar1(setting: FilterParameters) -> FilterParameters:
    """The belief without colour that is hardly any: beside a cause that was not there when it was fitted."""
    return replace(
        setting,
        noise_correlation=np.where(setting.noise_correlation < MIN_AR1, 0.0, setting.noise_correlation),
    )


def lag_one_correlation(records: Sequence[Record], passes: Sequence[FilterPass]) -> tuple[Array, Array]:
    """(channels,) correlation of innovations with the next of their channel, and its deviate; NaN where there
    are none."""
    products, pairs, squares = (np.zeros(len(CHANNELS)) for _ in range(3))
    for record, run in zip(records, passes, strict=True):
        for k in range(len(CHANNELS)):
            kind, c = place_of(k)
            rows = record.kinds == kind
            white = np.where(run.status[rows, c] == USED, run.white[rows, c], np.nan)
            product = white[1:] * white[:-1]
            products[k] += np.nansum(product)
            pairs[k] += np.isfinite(product).sum()
            squares[k] += np.nansum(white**2)
    with np.errstate(invalid="ignore"):
        correlation = products / squares
    return correlation, correlation * np.sqrt(pairs)


def _channels(nuisance: Nuisance) -> NDArray[np.int64]:
    """Those of the instrument whose colour it is."""
    return np.flatnonzero(np.array(INSTRUMENT_OF) == nuisance.entry[0])


def _stands_out(nuisance: Nuisance, correlation: Array, deviate: Array) -> bool:
    """Whether all channels that an instrument has look coloured; some may, from noise that the belief's own
    restlessness has taken in, much less than others."""
    own = _channels(nuisance)
    own = own[np.isfinite(deviate[own])]
    return bool(len(own) and deviate[own].min() > STANDS_OUT and correlation[own].mean() > MIN_AR1)


def _effect(nuisance: Nuisance) -> Effect:
    def apply(s: FilterParameters) -> FilterParameters:
        return with_value(nuisance, s, value_of(nuisance, s) + STEP)

    return Effect(nuisance.name, (), (NoiseChange(nuisance.name, apply, STEP),), (), True)


def _gained(records: Sequence[Record], before: Sequence[FilterPass], shaded: FilterParameters) -> Array:
    """(flights, channels) nats of a belief over the runs before, from the readings that both take."""
    after = in_threads(lambda record: whole(record, shaded), records)
    nats = np.zeros((len(records), len(CHANNELS)))
    for flight, (record, old, new) in enumerate(zip(records, before, after, strict=True)):
        events, c = np.nonzero((old.status == USED) & (new.status == USED))
        channels = CHANNEL_AT[record.kinds[events], c]
        np.add.at(nats[flight], channels, (new.nats - old.nats)[events, c])
    return nats


def _everywhere(gained: Array) -> bool:
    """Whether an instrument's colour explains something in each of its channels and each flight: an effect is
    in some axes and at some times."""
    parts = np.concatenate([gained.sum(axis=0), gained.sum(axis=1)])
    return bool((parts[parts != 0.0] > 0.0).all())
