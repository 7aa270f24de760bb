"use strict";
// All machines: one tile each, worst first, changed in place.

const RANK = { bad: 0, uncertain: 1, none: 2, good: 3 };
const list = document.getElementById("machines");
const tiles = new Map();

function tileOf(name) {
  let tile = tiles.get(name);
  if (tile) return tile;
  const item = el("li"), link = el("a", "tile");
  link.href = `/machines/${encodeURIComponent(name)}`;
  const head = el("span", "tile-head");
  const sign = el("span", "sign"), word = el("span", "tile-word");
  sign.setAttribute("aria-hidden", "true");
  head.append(el("span", "tile-name", name), sign, word);
  const values = el("span", "tile-values"), foot = el("span", "tile-foot");
  const reasons = el("span", "tile-reasons"), when = el("span", "tile-age");
  foot.append(reasons, when);
  link.append(head, values, foot);
  item.append(link);
  tile = { name, item, link, sign, word, values, axes: new Map(), reasons, when, quality: "", time: null };
  tiles.set(name, tile);
  return tile;
}

function update(one) {
  const tile = tileOf(one.machine);
  const quality = one.quality || "none";
  tile.time = one.time_s;
  const moved = one.displacement_um || {};
  // Of a model that has been replaced by one with other axes nothing stays.
  if ([...tile.axes.keys()].some((axis) => !(axis in moved))) {
    tile.values.replaceChildren();
    tile.axes.clear();
  }
  for (const [axis, value] of Object.entries(moved)) {
    let shownAt = tile.axes.get(axis);
    if (!shownAt) {
      const line = el("span", "tile-axis");
      shownAt = { value: el("b"), band: el("span", "band") };
      line.append(el("span", "axis", axis), shownAt.value, shownAt.band);
      tile.values.append(line);
      tile.axes.set(axis, shownAt);
    }
    const band = one.band_um[axis];
    write(shownAt.value, shown(value, 1, true));
    write(shownAt.band, band === null ? "µm" : `± ${shown(band)} µm`);
  }
  write(tile.reasons, quality === "none" ? "no sample yet" : sentences(one.status));
  if (quality === tile.quality) return false;
  tile.quality = quality;
  tile.link.dataset.quality = quality;
  write(tile.sign, SIGNS[quality]);
  write(tile.word, quality === "none" ? "waiting" : quality);
  return true;
}

function order() {
  const active = document.activeElement;
  const sorted = [...tiles.values()].sort((a, b) =>
    RANK[a.quality] - RANK[b.quality] || a.name.localeCompare(b.name, "en", { numeric: true }));
  list.append(...sorted.map((tile) => tile.item));
  if (active && list.contains(active)) active.focus({ preventScroll: true });
  const many = (quality) => sorted.filter((tile) => tile.quality === quality).length;
  const parts = ["bad", "uncertain", "good", "none"]
    .filter((quality) => many(quality))
    .map((quality) => `${many(quality)} ${quality === "none" ? "waiting" : quality}`);
  write(document.getElementById("counts"), parts.join(" · "));
  document.title = `${many("bad") ? `${many("bad")} bad – ` : ""}Machines – thermojoint`;
}

function news(publications) {
  const moved = publications.map(update);
  if (moved.some(Boolean)) order();
}

function ages() {
  const now = clock.now();
  for (const tile of tiles.values()) {
    if (tile.time) write(tile.when, age(now - tile.time));
  }
}

document.getElementById("find").addEventListener("input", (event) => {
  const wanted = event.target.value.trim().toLowerCase();
  let seen = 0;
  for (const tile of tiles.values()) {
    tile.item.hidden = !tile.name.toLowerCase().includes(wanted);
    seen += !tile.item.hidden;
  }
  document.getElementById("none").hidden = seen > 0;
});

ask("/api/machines").then((body) => {
  clock.offset = body.now_s - Date.now() / 1000;
  body.machines.forEach(update);
  order();
  ages();
  listen("/api/stream?every_s=1", news, () => {});
  setInterval(ages, 1000);
});
