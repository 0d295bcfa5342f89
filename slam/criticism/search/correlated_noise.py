"""AR(1) noise of instruments, which is healthy, but which no filter for white noise describes.

Correlated innovations may come from correlated noise, or from an effect that the parameters lack. AR(1) noise
therefore competes with the causes. Where the correlation is significant, the coefficients are fitted with the
nuisances and the filter is run anew. They are accepted where they explain more than the best cause or
residual pattern, and something in every channel of the instrument and in every flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import FilterPass, whole
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, INSTRUMENT_OF
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.fitted_parameters import AR1_COEFFICIENTS, FittedParameter
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.threads import in_threads

Array = NDArray[np.float64]

MIN_AR1 = 0.05
"""Least AR(1) coefficient. A smaller one exaggerates innovations by a twentieth at most: it is none."""
STANDS_OUT = 3.0
"""Least normal deviate of the lag-one correlation in every channel of an instrument."""
LEAD_NATS = 20.0
"""Lead by which AR(1) noise must exceed the best other explanation."""


def ar1_effects(parameters: FilterParameters) -> tuple[Effect, ...]:
    """Return the AR(1) coefficients of the instruments with correlated noise, as effects to be fitted."""
    return tuple(_effect(n) for n in AR1_COEFFICIENTS if n.value_in(parameters) > 0.0)


def with_ar1_noise(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    passes: Sequence[FilterPass],
    chosen: Sequence[Effect],
    most_nats: float,
) -> FilterParameters | None:
    """Return the parameters with AR(1) noise, if that explains more of the flights than anything else; else
    None.

    ``passes`` are the filter's runs under ``parameters``, which hold the ``chosen`` terms. ``most_nats`` is
    the gain of the best other explanation. Instruments of an out-of-model vehicle are not tested.
    """
    correlation, deviate = lag_one_correlation(records, passes)
    seen = [] if model.out_of_model else [n for n in AR1_COEFFICIENTS if _stands_out(n, correlation, deviate)]
    # AR(1) noise explains about half the squared deviates: no fit where even twice that is too little.
    if np.nansum(deviate[[c for n in seen for c in _channels(n)]] ** 2) < most_nats:
        return None
    while seen:
        correlated = fit_nuisances(records, model, parameters, [*chosen, *(_effect(n) for n in seen)])
        correlated = without_small_ar1(correlated)
        gained = _gained(records, passes, correlated)
        kept = [n for n in seen if n.value_in(correlated) > 0.0 and _everywhere(gained[:, _channels(n)])]
        if kept == seen:
            break
        seen = kept
    # A gain of the refitted nuisances elsewhere does not count for AR(1) noise; a loss does.
    own = [channel for n in seen for channel in _channels(n)]
    if not seen or min(gained[:, own].sum(), gained.sum()) < most_nats + LEAD_NATS:
        return None
    return without_small_ar1(fit_nuisances(records, model, correlated, [*chosen, *ar1_effects(correlated)]))


def without_small_ar1(parameters: FilterParameters) -> FilterParameters:
    """Set negligible AR(1) coefficients to zero: they were fitted while a cause was absent."""
    return replace(
        parameters,
        noise_correlation=np.where(parameters.noise_correlation < MIN_AR1, 0.0, parameters.noise_correlation),
    )


def lag_one_correlation(records: Sequence[Record], passes: Sequence[FilterPass]) -> tuple[Array, Array]:
    """Return (channels,) lag-one correlations of the innovations and their normal deviates; NaN for none."""
    products, pairs, squares = (np.zeros(len(CHANNELS)) for _ in range(3))
    for record, run in zip(records, passes, strict=True):
        for k in range(len(CHANNELS)):
            _, white, status = run.of_channel(record, k)
            white = np.where(status == USED, white, np.nan)
            product = white[1:] * white[:-1]
            products[k] += np.nansum(product)
            pairs[k] += np.isfinite(product).sum()
            squares[k] += np.nansum(white**2)
    with np.errstate(invalid="ignore"):
        correlation = products / squares
    return correlation, correlation * np.sqrt(pairs)


def _channels(nuisance: FittedParameter) -> NDArray[np.int64]:
    """Return the channels of the instrument whose coefficient it is."""
    return np.flatnonzero(np.array(INSTRUMENT_OF) == nuisance.entries[0])


def _stands_out(nuisance: FittedParameter, correlation: Array, deviate: Array) -> bool:
    """Whether the noise of all channels of an instrument looks correlated. Some may look so much less than
    others, where the process noise has absorbed a part."""
    own = _channels(nuisance)
    own = own[np.isfinite(deviate[own])]
    return bool(len(own) and deviate[own].min() > STANDS_OUT and correlation[own].mean() > MIN_AR1)


def _effect(coefficient: FittedParameter) -> Effect:
    return Effect(coefficient.name, changes=(coefficient,), positive=True)


def _gained(records: Sequence[Record], before: Sequence[FilterPass], correlated: FilterParameters) -> Array:
    """Return (flights, channels) gains in nats over the runs before, from the readings that both use."""
    after = in_threads(lambda record: whole(record, correlated), records)
    nats = np.zeros((len(records), len(CHANNELS)))
    for flight, (record, old, new) in enumerate(zip(records, before, after, strict=True)):
        events, c = np.nonzero((old.status == USED) & (new.status == USED))
        channels = CHANNEL_AT[record.kinds[events], c]
        np.add.at(nats[flight], channels, (new.nats - old.nats)[events, c])
    return nats


def _everywhere(gained: Array) -> bool:
    """Whether AR(1) noise explains something in each channel of an instrument and each flight. An effect acts
    on some axes and at some times."""
    parts = np.concatenate([gained.sum(axis=0), gained.sum(axis=1)])
    return bool((parts[parts != 0.0] > 0.0).all())
