"""The page ``map.html``: mosaics, elevation, uncertainty, path and links on one interactive map.

Leaflet draws the map (leafletjs.com, BSD licence in ``LICENSE.leaflet``). It is part of the page, which needs
no network.
"""
