"use strict";
/* The script of map.html. Coordinates are metres of the map: Leaflet's latitude is y, its longitude x. */
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const frames = data.keyframes;
  // Okabe and Ito's colours, which colour-blind readers can distinguish.
  const GREEN = "#009e73", VERMILLION = "#d55e00", BLUE = "#0072b2", GREY = "#8a8f98", BLACK = "#1f2328";
  const element = (name) => document.getElementById(name);

  /* ---- numbers as text ---- */

  function significant(value) {
    return Number(value.toPrecision(3)).toString();
  }

  function lengthText(metres) {
    if (!data.metric) return `${significant(metres)} ${data.unit}`;
    const size = Math.abs(metres);
    if (size < 0.1) return `${significant(1e3 * metres)} mm`;
    return size < 1e4 ? `${significant(metres)} m` : `${significant(metres / 1e3)} km`;
  }

  function exactText(metres) {
    const digits = data.metric ? 3 : 4, text = metres.toFixed(digits);
    return `${Number(text) === 0 ? (0).toFixed(digits) : text} ${data.unit}`;
  }

  /* ---- the map and its coordinates ---- */

  const placed = frames.x.map((x, k) => [frames.y[k], x]);
  const frame = data.tiles || frameOf(placed);
  const coarsest = frame.gsd * 2 ** (frame.levels - 1); // metres a pixel at zoom 0
  const crs = L.extend({}, L.CRS.Simple, {
    transformation: new L.Transformation(1 / coarsest, -frame.west / coarsest, -1 / coarsest, frame.north / coarsest),
  });
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const map = L.map("map", {
    crs, minZoom: -3, maxZoom: frame.levels + 3, zoomSnap: 0.25, attributionControl: false, preferCanvas: true,
    zoomAnimation: !still, fadeAnimation: !still, inertia: !still,
  });
  const canvas = L.canvas({ tolerance: 6, padding: 0.3 });
  // On a phone the panel covers the lower half of the map.
  const position = matchMedia("(max-width: 40rem)").matches ? "topright" : "bottomleft";
  if (data.metric) L.control.scale({ imperial: false, maxWidth: 160, position }).addTo(map);
  ["chain", "mosaic", "grids"].forEach((name, k) => { map.createPane(name).style.zIndex = 210 + 10 * k; });

  function frameOf(points) {
    const box = L.latLngBounds(points), size = Math.max(box.getEast() - box.getWest(), box.getNorth() - box.getSouth());
    return { west: box.getWest(), north: box.getNorth(), gsd: (size || 1) / 1024, levels: 3 };
  }

  /* ---- images as tiles ---- */

  const ImageTiles = L.GridLayer.extend({
    createTile(at) {
      const code = this.options.images[`${at.z}/${at.x}/${at.y}`];
      if (!code) return document.createElement("div");
      const tile = document.createElement("img");
      tile.src = `data:image/webp;base64,${code}`;
      tile.alt = "";
      return tile;
    },
    _initTile(tile) {
      // At a zoom between two levels the edges of neighbours are half transparent: a pixel of overlap hides it.
      L.GridLayer.prototype._initTile.call(this, tile);
      tile.style.width = tile.style.height = `${frame.tilePx + 1}px`;
      tile.style.mixBlendMode = "normal";
    },
  });

  function imageLayer(name, pane) {
    const images = data.tiles && data.tiles.images[name];
    if (!images) return null;
    const levels = frame.levels - 1;
    return new ImageTiles({
      images, pane, tileSize: frame.tilePx, minNativeZoom: 0, maxNativeZoom: levels, minZoom: -3, maxZoom: levels + 4,
    });
  }

  /* ---- colours ---- */

  function colourOf(share) {
    const at = Math.min(Math.max(share, 0), 1) * (data.colours.length - 1), k = Math.min(Math.floor(at), data.colours.length - 2);
    return data.colours[k].map((c, n) => Math.round(c + (at - k) * (data.colours[k + 1][n] - c)));
  }

  const css = (colour) => `rgb(${colour.join(",")})`;

  function bar(title, low, high, text) {
    const box = document.createElement("div"), stops = data.colours.map(css).join(",");
    const strip = document.createElement("div"), ends = document.createElement("div");
    box.append(title);
    strip.className = "bar";
    strip.style.background = `linear-gradient(to right,${stops})`;
    ends.className = "ends";
    [low, high].forEach((value) => {
      const end = document.createElement("span");
      end.textContent = text(value);
      ends.append(end);
    });
    box.append(strip, ends);
    return box;
  }

  /* ---- grids of values: elevation, uncertainty ---- */

  const floats = (code) => new Float32Array(Uint8Array.from(atob(code), (c) => c.charCodeAt(0)).buffer);
  Object.values(data.grids).forEach((grid) => { grid.values = floats(grid.data); });

  function valueAt(grid, x, y) {
    const col = Math.floor((x - grid.west) / grid.cell), row = Math.floor((grid.north - y) / grid.cell);
    const inside = col >= 0 && row >= 0 && col < grid.cols && row < grid.rows;
    return inside ? grid.values[row * grid.cols + col] : NaN;
  }

  function valueLayer(grid) {
    const picture = document.createElement("canvas");
    picture.width = grid.cols;
    picture.height = grid.rows;
    const context = picture.getContext("2d"), pixels = context.createImageData(grid.cols, grid.rows);
    const span = grid.high - grid.low || 1;
    grid.values.forEach((value, k) => {
      if (Number.isFinite(value)) pixels.data.set([...colourOf((value - grid.low) / span), 255], 4 * k);
    });
    context.putImageData(pixels, 0, 0);
    const south = grid.north - grid.rows * grid.cell, east = grid.west + grid.cols * grid.cell;
    return L.imageOverlay(picture.toDataURL(), [[south, grid.west], [grid.north, east]], { opacity: 0.75, pane: "grids" });
  }

  /* ---- path, keyframes, links ---- */

  const paths = {
    time: ["Time since the start", frames.time, (value) => `${significant(value)} s`],
    height: ["Height over the ground", frames.height, lengthText],
    sigma: ["Uncertainty of the position, 1σ", frames.sigma, lengthText],
  };
  Object.keys(paths).forEach((name) => { if (!paths[name][1].some((value) => value !== null)) delete paths[name]; });

  function limits(values) {
    const known = values.filter((value) => value !== null);
    return [known.reduce((a, b) => Math.min(a, b), Infinity), known.reduce((a, b) => Math.max(a, b), -Infinity)];
  }

  const path = L.layerGroup(placed.slice(1).flatMap((end, k) =>
    frames.part[k] === frames.part[k + 1] ? [L.polyline([placed[k], end], {
      weight: 4, dashArray: frames.unseen[k + 1] ? "1 8" : null, renderer: canvas, interactive: false,
    })] : []));
  const segments = path.getLayers();
  const segmentEnds = placed.slice(1).map((_, k) => k + 1).filter((k) => frames.part[k - 1] === frames.part[k]);

  function colourPath(name) {
    if (!paths[name]) return segments.forEach((segment) => segment.setStyle({ color: BLUE }));
    const values = paths[name][1], [low, high] = limits(values);
    return segments.forEach((segment, n) => {
      const value = values[segmentEnds[n]];
      segment.setStyle({ color: value === null ? GREY : css(colourOf((value - low) / (high - low || 1))) });
    });
  }

  function lines(rows) {
    const box = document.createElement("div");
    rows.filter((row) => row).forEach((row) => {
      const line = document.createElement("div");
      line.textContent = row;
      box.append(line);
    });
    return box;
  }

  function keyframeText(k) {
    const known = (value, text) => (value === null ? "" : text(value));
    const box = lines([
      `Keyframe ${frames.number[k]}${frames.name[k] ? `, ${frames.name[k]}` : ""}`,
      known(frames.time[k], (value) => `${value} s after the start`),
      `x ${exactText(frames.x[k])}, y ${exactText(frames.y[k])}`,
      `${exactText(frames.height[k])} over the ground`,
      known(frames.sigma[k], (value) => `position known to ${lengthText(value)} (1σ)`),
    ]);
    const picture = frames.picture[frames.number[k]];
    if (picture) {
      const image = document.createElement("img");
      image.src = `data:image/webp;base64,${picture}`;
      image.alt = `Picture of keyframe ${frames.number[k]}`;
      box.append(image);
    }
    return box;
  }

  // Thousands of marks are made when they are first asked for, so that the page opens at once.
  function lazily(marks) {
    const layer = L.layerGroup();
    layer.once("add", () => marks().forEach((mark) => mark.addTo(layer)));
    return layer;
  }

  const keyframes = lazily(() => placed.map((at, k) =>
    L.circleMarker(at, { radius: 4, weight: 2, color: BLACK, fillColor: "#fff", fillOpacity: 1, renderer: canvas })
      .bindPopup(() => keyframeText(k))));
  const rowOf = new Map(frames.number.map((number, k) => [number, k]));
  const linkKinds = {
    loop: ["Loop closures, kept", GREEN, null, "Two visits of one place were matched, and the match was kept."],
    contradicted: ["Loop closures, contradicted", VERMILLION, "6 5", "Rejected, because the rest of the map contradicts it: "],
    unproven: ["Loop closures, unproven", GREY, "1 5", "Rejected, because it shows too little to tell whether it is right: "],
    odometry: ["Links between neighbours", BLUE, null, "Two successive keyframes were matched."],
  };

  function linkLayer(kind) {
    const [, color, dashArray, words] = linkKinds[kind];
    return lazily(() => data.links[kind].pairs.map(([i, j, reason]) =>
      L.polyline([placed[rowOf.get(i)], placed[rowOf.get(j)]], { color, dashArray, weight: 2, opacity: 0.8, renderer: canvas })
        .bindPopup(() => lines([`Keyframes ${i} and ${j}`, words + reason]))));
  }

  /* ---- points of the ground ---- */

  const FEWEST = 2; // keyframes that determine a point

  function points() {
    const values = floats(data.points.data);
    return Array.from({ length: values.length / 4 }, (_, k) => {
      const [x, y, height, views] = values.subarray(4 * k, 4 * k + 4);
      const fillColor = css(colourOf((views - FEWEST) / (data.points.high - FEWEST)));
      return L.circleMarker([y, x], { radius: 3, weight: 1, color: BLACK, opacity: 0.6, fillColor, fillOpacity: 1, renderer: canvas })
        .bindPopup(() => pointText(x, y, height, views));
    });
  }

  function pointText(x, y, height, views) {
    const std = pointStd([x, y]);
    return lines([
      `Point of the ground, seen in ${views} keyframes`,
      `x ${exactText(x)}, y ${exactText(y)}`,
      `${lengthText(Math.abs(height))} ${height < 0 ? "below" : "over"} the floor`,
      Number.isFinite(std) ? `position known to ${lengthText(std)} (1σ)` : "",
    ]);
  }

  const surveyed = lazily(() => data.surveyed.map(({ x, y, words }) =>
    L.circleMarker([y, x], { radius: 7, weight: 3, color: BLACK, fillColor: "#fff", fillOpacity: 1, renderer: canvas })
      .bindPopup(() => lines(words))));

  /* ---- the panel ---- */

  const shown = new Set();

  function addLayer(name, title, layer, on, swatch) {
    if (!layer) return;
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = on;
    box.id = `show-${name}`;
    label.append(box, " ");
    if (swatch) label.append(swatch);
    label.append(title);
    box.addEventListener("change", () => show(name, layer, box.checked));
    element("layers").append(label);
    show(name, layer, on);
  }

  function show(name, layer, on) {
    if (on) layer.addTo(map);
    else layer.remove();
    // The points lie under the path, which is thinner than they are many.
    if (shown.has("path") || name === "path") segments.filter((one) => map.hasLayer(one)).forEach((one) => one.bringToFront());
    if (on) shown.add(name);
    else shown.delete(name);
    drawLegend();
  }

  function swatch(color, dashed) {
    const mark = document.createElement("span");
    mark.className = `swatch ${dashed || ""}`;
    mark.style.borderColor = color;
    return mark;
  }

  function drawLegend() {
    const legend = element("legend"), chosen = paths[colouring];
    legend.replaceChildren();
    if (chosen && shown.has("path")) legend.append(bar(`Path: ${chosen[0].toLowerCase()}`, ...limits(chosen[1]), chosen[2]));
    if (shown.has("path") && frames.unseen.includes(true)) legend.append(lines(["Path, dotted: no usable picture shows the ground."]));
    const titles = { elevation: "Height of the ground over the floor", sigma: "Uncertainty of the ground's position, 1σ" };
    Object.entries(titles).forEach(([name, title]) => {
      const grid = data.grids[name];
      if (grid && shown.has(name)) legend.append(bar(title, grid.low, grid.high, lengthText));
    });
    if (shown.has("points")) {
      const title = "Points of the ground: number of keyframes that see each";
      legend.append(bar(title, FEWEST, data.points.high, (value) => Math.round(value).toString()));
    }
  }

  let colouring = Object.keys(paths)[0];
  Object.entries(paths).forEach(([name, [title]]) => {
    const label = document.createElement("label"), choice = document.createElement("input");
    choice.type = "radio";
    choice.name = "colouring";
    choice.id = `colour-${name}`;
    choice.checked = name === colouring;
    choice.addEventListener("change", () => { colouring = name; colourPath(name); drawLegend(); });
    label.append(choice, ` ${title}`);
    element("colour").append(label);
  });
  element("colour").hidden = Object.keys(paths).length < 2;
  colourPath(colouring);

  const panel = element("panel").getBoundingClientRect(), narrow = panel.width > window.innerWidth / 2;
  const covered = narrow ? [0, panel.height] : [panel.width, 0];
  map.fitBounds(L.latLngBounds(placed).pad(0.15), { animate: false, paddingBottomRight: covered });
  const chain = imageLayer("chain", "chain");
  addLayer("map", "Mosaic", imageLayer("map", "mosaic"), true);
  addLayer("elevation", "Height of the ground", data.grids.elevation && valueLayer(data.grids.elevation), false);
  addLayer("sigma", "Uncertainty of the ground", data.grids.sigma && valueLayer(data.grids.sigma), false);
  if (data.points) {
    const drawn = floats(data.points.data).length / 4, some = drawn < data.points.count ? `, ${drawn} drawn` : "";
    addLayer("points", `Points of the ground that hold the map (${data.points.count}${some})`, lazily(points), false);
  }
  addLayer("surveyed", `Control points and check points (${data.surveyed.length})`, data.surveyed.length ? surveyed : null, true);
  addLayer("path", "Path of the drone", path, true);
  Object.keys(linkKinds).forEach((kind) => {
    const { count, pairs } = data.links[kind], [title, color, dashed] = linkKinds[kind];
    const some = pairs.length < count ? `, ${pairs.length} drawn` : "";
    const style = { "6 5": "dashed", "1 5": "dotted" }[dashed];
    addLayer(kind, `${title} (${count}${some})`, count ? linkLayer(kind) : null, false, swatch(color, style));
  });
  addLayer("keyframes", `Keyframes (${placed.length})`, keyframes, false);

  /* ---- before and after ---- */

  const divider = document.createElement("div");
  divider.className = "divider";
  divider.hidden = true;
  element("map").append(divider);

  function divide() {
    const share = Number(element("swipe").value) / 100, size = map.getSize();
    const [left, right] = [map.containerPointToLayerPoint([0, 0]), map.containerPointToLayerPoint(size)];
    const x = left.x + share * size.x, top = left.y, bottom = right.y;
    const box = (from, to) => `polygon(${from}px ${top}px,${to}px ${top}px,${to}px ${bottom}px,${from}px ${bottom}px)`;
    map.getPane("chain").style.clipPath = box(left.x, x);
    map.getPane("mosaic").style.clipPath = box(x, right.x);
    divider.style.left = `${100 * share}%`;
    divider.hidden = share === 0;
  }

  if (chain) {
    chain.addTo(map);
    element("compare").hidden = false;
    element("swipe").addEventListener("input", divide);
    map.on("move zoomend resize viewreset", divide);
    divide();
  }

  /* ---- measuring ---- */

  const measure = { on: false, points: [], line: L.polygon([], { color: BLACK, weight: 3, dashArray: "4 4", fillOpacity: 0.1, renderer: canvas, interactive: false }) };

  const away = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

  /* Standard deviation of a point of the ground relative to the middle of the map, NaN where no picture shows
     it. */
  function pointStd([x, y]) {
    const std = data.grids.sigma ? valueAt(data.grids.sigma, x, y) : NaN;
    return Math.sqrt(Math.max(std * std - data.middleStd * data.middleStd, 0));
  }

  /* Standard deviation of a distance by the joint covariance of its ends: column 1 of the table for a typical
     one, 2 for a badly known one. The nearest places of the table stand for still nearer ones. */
  function lengthStd(distance, column) {
    const table = data.lengthStds, after = table.findIndex((row) => row[0] >= distance);
    if (after === 0) return table[0][column];
    if (after < 0) return table[table.length - 1][column] * distance / table[table.length - 1][0];
    const low = table[after - 1], high = table[after];
    return low[column] + (high[column] - low[column]) * (distance - low[0]) / (high[0] - low[0]);
  }

  /* Standard deviation of what moves by ``weights`` when the points move, and by ``byScale`` with the scale.
     Of a distance, what is not the scale is split between its ends. Without a table, errors of the points may
     be shared in any way, the scale among them: then their sum is the upper limit. */
  function stdOf(points, weights, byScale, column) {
    const stds = points.map(pointStd), sum = (terms) => terms.reduce((total, each) => total + each, 0);
    if (!stds.every(Number.isFinite)) return NaN;
    if (!data.lengthStds.length) return sum(stds.map((std, k) => std * weights[k]));
    const across = Math.max(...points.map((p) => Math.max(...points.map((q) => away(p, q)))));
    const end = Math.sqrt(Math.max(lengthStd(across, column) ** 2 - (data.scaleStd * across) ** 2, 0) / 2);
    return Math.hypot(byScale, ...weights.map((weight) => end * weight));
  }

  function withStd(points, value, weights, byScale) {
    const [std, worst] = [1, 2].map((column) => stdOf(points, weights, byScale, column));
    return { value, std, worst };
  }

  function distanceOf(points) {
    const unit = (a, b) => { const d = away(a, b) || 1; return [(b[0] - a[0]) / d, (b[1] - a[1]) / d]; };
    const sides = points.slice(1).map((b, k) => unit(points[k], b));
    const value = points.slice(1).reduce((sum, b, k) => sum + away(points[k], b), 0);
    const weights = points.map((p, k) => away(sides[k - 1] || [0, 0], sides[k] || [0, 0]));
    return withStd(points, value, weights, data.scaleStd * value);
  }

  function areaOf(points) {
    const next = (k) => points[(k + 1) % points.length], previous = (k) => points[(k + points.length - 1) % points.length];
    const value = Math.abs(points.reduce((sum, p, k) => sum + p[0] * next(k)[1] - next(k)[0] * p[1], 0)) / 2;
    const weights = points.map((p, k) => away(next(k), previous(k)) / 2);
    return withStd(points, value, weights, 2 * data.scaleStd * value);
  }

  function upTo({ std, worst }, text) {
    if (!Number.isFinite(std)) return "(uncertainty not known: not on mapped ground)";
    return data.lengthStds.length ? `± ${text(std)} (1σ, typically; ± ${text(worst)} where both ends are badly known)` : `± ${text(std)} (1σ, at most)`;
  }

  function measured(points) {
    if (points.length < 2) return "Click points on the map, or press Space to take its centre. Enter ends, Escape clears.";
    const along = distanceOf(points), texts = [`Distance ${exactText(along.value)} ${upTo(along, lengthText)}`];
    if (points.length > 2) {
      const area = areaOf(points), areaText = (value) => `${significant(value)} ${data.unit}²`;
      texts.push(`Area ${areaText(area.value)} ${upTo(area, areaText)}`);
    }
    return `${texts.join(". ")}.`;
  }

  function drawMeasured() {
    measure.line.setLatLngs(measure.points.map(([x, y]) => [y, x]));
    measure.line.setStyle({ fill: measure.points.length > 2 });
    element("measured").textContent = measure.on || measure.points.length ? measured(measure.points) : "";
    element("measure-clear").hidden = !measure.points.length;
    element("map").classList.toggle("measuring", measure.on);
    element("measure-start").setAttribute("aria-pressed", measure.on);
  }

  function setMeasuring(on) {
    measure.on = on;
    if (on) {
      measure.points = [];
      measure.line.addTo(map);
      map.closePopup();
      map.doubleClickZoom.disable();
      element("map").focus();
    } else map.doubleClickZoom.enable();
    drawMeasured();
  }

  function addPoint(at) {
    measure.points.push([at.lng, at.lat]);
    drawMeasured();
  }

  element("measure-start").addEventListener("click", () => setMeasuring(!measure.on));
  element("measure-clear").addEventListener("click", () => { measure.points = []; setMeasuring(false); });
  map.on("preclick", (event) => { if (measure.on) addPoint(event.latlng); });
  map.on("popupopen", () => { if (measure.on) map.closePopup(); });
  element("map").addEventListener("keydown", (event) => {
    if (!measure.on) return;
    if (event.key === " ") addPoint(map.getCenter());
    else if (event.key === "Enter") setMeasuring(false);
    else if (event.key === "Escape") { measure.points = []; setMeasuring(false); }
    else return;
    event.preventDefault();
  });

  /* ---- the place under the pointer ---- */

  map.on("mousemove", (event) => {
    const { lat: y, lng: x } = event.latlng, [first, second] = data.onEarth ? ["east", "north"] : ["x", "y"];
    const read = (name, text) => {
      const value = data.grids[name] ? valueAt(data.grids[name], x, y) : NaN;
      return Number.isFinite(value) ? text(value) : "";
    };
    element("readout").textContent = [
      `${first} ${exactText(x)}, ${second} ${exactText(y)}`,
      read("elevation", (value) => `ground ${lengthText(value)} high`),
      read("sigma", (value) => `known to ${lengthText(value)} (1σ)`),
    ].filter((text) => text).join(" · ");
  });
  map.on("mouseout", () => { element("readout").textContent = ""; });

  window.lemniscate = { map, data, distanceOf, areaOf };
})();
