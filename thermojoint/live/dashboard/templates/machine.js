"use strict";
// One machine: status, axes, curves, readings, model, events; changed in place.

const name = document.getElementById("machine").textContent;
const base = `/api/machines/${encodeURIComponent(name)}`;
const SPANS = [["15 min", 900], ["1 h", 3600], ["8 h", 28800], ["24 h", 86400], ["7 d", 604800]];
const POINTS = 720;
const COLUMNS = ["displacement_um", "band_um", "offsets_um", "slopes_um_per_m", "details", "readings"];
//: What a unit at the end of a name is called, in what it is shown, and over which heading.
const UNITS = {
  W: ["Heat", "W", 1], K: ["Estimated temperatures", "K", 1], Pa: ["Pressure in the joints", "MPa", 1e-6],
  um: ["Parts of the displacement", "µm", 1], "": ["Relative", "1", 1], degC: ["Temperatures", "°C", 1],
  rpm: ["Speed", "1/min", 1], kW: ["Power", "kW", 1], A: ["Current", "A", 1], Nm: ["Torque", "Nm", 1],
  percent: ["Load", "%", 1], degF: ["Temperatures", "°F", 1], um_per_m: ["Slopes", "µm/m", 1], mm: ["Positions", "mm", 1],
  m: ["Positions", "m", 1], nm: ["Displacement", "nm", 1], rad_s: ["Speed", "rad/s", 1], deg_s: ["Speed", "°/s", 1],
  mm_s: ["Feed", "mm/s", 1], mm_min: ["Feed", "mm/min", 1], m_min: ["Feed", "m/min", 1],
};

const page = { about: null, span: 3600, past: null, newest: null, charts: [], revision: 0, drawn: 0, line: "opening" };

// The longest of the units that a name ends in.
function unitOf(key) {
  const found = Object.keys(UNITS).filter((unit) => unit && key.endsWith(`_${unit}`));
  return found.sort((one, other) => other.length - one.length)[0] || "";
}

function bare(key) {
  const unit = unitOf(key);
  return (unit ? key.slice(0, -unit.length - 1) : key).replaceAll("_", " ");
}

// Which charts there are: offsets, then details and readings by unit.
function plan(about) {
  const found = [];
  if (about.controls.length) {
    found.push({ title: "Sent to the control", unit: "µm", group: "offsets_um", keys: about.controls, factor: 1 });
  }
  if (about.P0_mm) {
    found.push({ title: "Slope sent to the control", unit: "µm/m", group: "slopes_um_per_m", keys: Object.keys(about.P0_mm), factor: 1 });
  }
  for (const group of ["details", "readings"]) {
    for (const unit of Object.keys(UNITS)) {
      const keys = about[group].filter((key) => unitOf(key) === unit);
      if (!keys.length) continue;
      const [title, shownUnit, factor] = UNITS[unit];
      const read = unit === "um" ? "Displacement, as read by a probe" : "Readings";
      // A probe reads now and then: points, no line between them.
      const mode = group === "readings" && unit === "um" ? "markers" : "lines";
      found.push({ title: group === "readings" ? read : title, unit: shownUnit, group, keys, factor, mode });
    }
  }
  return found.map((chart) => {
    const card = el("section", "card"), node = el("div", "chart");
    const heading = chart.unit === "1" ? chart.title : `${chart.title}, ${chart.unit}`;
    card.append(el("h2", "", heading), node);
    node.setAttribute("role", "img");
    node.setAttribute("aria-label", `${heading} over time: ${chart.keys.map(bare).join(", ")}`);
    document.getElementById("charts").append(card);
    const curves = (past) => chart.keys.map((key) => (
      { name: bare(key), values: scaled(past[chart.group][key], chart.factor), mode: chart.mode }));
    const used = (one) => chart.keys.some((key) => valueOf(one, chart.group, key) !== null);
    return { node, card, curves, used };
  });
}

// A model that replaced another while the page was open may not have a value, or none of a group.
function valueOf(one, group, key) {
  return (one[group] || {})[key] ?? null;
}

function scaled(values, factor) {
  return factor === 1 ? values : values.map((value) => (value === null ? null : factor * value));
}

// Only what is in view is drawn: a phone has better things to do.
const inView = new Set();
const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting) inView.add(entry.target);
    else inView.delete(entry.target);
  }
  if (entries.some((entry) => entry.isIntersecting)) drawAll();
}, { rootMargin: "200px" });

async function drawAll() {
  if (!page.past || document.hidden) return;
  page.revision += 1;
  page.drawn = Date.now();
  const to = clock.now(), from = to - page.span, past = page.past;
  for (const chart of page.charts) {
    if (!inView.has(chart.node)) continue;
    const curves = chart.curves(past);
    await draw(chart.node, past.time_s, curves, from, to, page.revision);
  }
}

function displacementCurves(past) {
  // A history that began with another model may lack an axis.
  return page.about.axes.filter((axis) => axis in past.band_um).map((axis) => {
    const band = past.band_um[axis];
    return { name: `δ${axis}`, values: past.displacement_um[axis], band: band.some((one) => one !== null) ? band : null };
  });
}

async function load() {
  const span = page.span, now = clock.now();
  const past = await ask(`${base}/history?since=${(now - span).toFixed(3)}&until=${(now + 60).toFixed(3)}&points=${POINTS}`);
  if (span !== page.span) return;
  page.past = past;
  past.holes.forEach((hole) => interrupt(past, hole));
  if (page.newest) append(page.newest);
  // A probe that is never read needs no empty chart.
  for (const chart of page.charts) {
    if (chart.card) chart.card.hidden = chart.curves(past).every((one) => one.values.every((value) => value === null));
  }
  await drawAll();
}

// Slopes are there only where the control receives any.
function columns(past) {
  return COLUMNS.filter((group) => group in past);
}

// No line across a time without samples.
function interrupt(past, hole) {
  const at = past.time_s.findIndex((time) => time > hole.since_s);
  if (at <= 0) return;
  past.time_s.splice(at, 0, (past.time_s[at - 1] + past.time_s[at]) / 2);
  for (const group of columns(past)) for (const column of Object.values(past[group])) column.splice(at, 0, null);
}

// The newest sample behind the curves; what is older than the span goes, and the rest stays bounded.
function append(one) {
  const past = page.past, times = past.time_s;
  const later = times.findIndex((time) => time >= one.time_s);
  if (one.time_s === null || times[later] === one.time_s) return;
  // What is later is from before the clock was set back.
  if (later >= 0) remove(past, later, times.length);
  times.push(one.time_s);
  for (const group of columns(past)) {
    for (const [key, column] of Object.entries(past[group])) column.push(valueOf(one, group, key));
  }
  const gone = times.findIndex((time) => time >= clock.now() - page.span);
  if (gone > 0) remove(past, 0, gone);
}

function remove(past, first, count) {
  past.time_s.splice(first, count);
  for (const group of columns(past)) for (const column of Object.values(past[group])) column.splice(first, count);
}

function status() {
  const one = page.newest, lost = page.line === "lost";
  const quality = lost ? "lost" : one ? one.quality : "none";
  document.getElementById("status").dataset.quality = quality;
  write(document.querySelector("#status .sign"), lost ? "⚠" : SIGNS[quality]);
  write(document.getElementById("word"), lost ? "no connection" : one ? quality : "waiting");
  const since = one && one.time_s ? clockTime(one.time_s) : "";
  write(document.getElementById("reasons"), lost
    ? `The values below are old${since ? `: from ${since}` : ""}.`
    : one ? sentences(one.status) : "no sample yet");
}

function ages() {
  if (page.newest) write(document.getElementById("age"), age(clock.now() - page.newest.time_s));
}

function axisCard(id, kind, title, note) {
  let item = document.getElementById(id);
  if (!item) {
    item = el("li", kind);
    item.id = id;
    const value = el("p", "value");
    value.append(el("b", "number"), " µm");
    item.append(el("p", "axis", title), value, el("p", "band", note));
    document.getElementById("axes").append(item);
  }
  return item;
}

function axes() {
  const one = page.newest;
  for (const axis of page.about.axes) {
    const item = axisCard(`axis-${axis}`, "card axis-now", `δ${axis}`);
    const band = valueOf(one, "band_um", axis);
    write(item.querySelector(".number"), shown(one.displacement_um[axis], 1, true));
    write(item.querySelector(".band"), band === null ? "band unknown" : `± ${shown(band, 2)} µm (95 %)`);
  }
  for (const control of page.about.controls) {
    const item = axisCard(
      `offset-${control}`, "card axis-now offset", `${control} of the control`, "offset sent");
    write(item.querySelector(".number"), shown(one.offsets_um[control], 1, true));
    const slope = one.slopes_um_per_m && one.slopes_um_per_m[control];
    if (slope === undefined) continue;
    write(item.querySelector(".band"), `K0 sent, at P0 = ${shown(one.P0_mm[control], 1)} mm; tan β ${shown(slope, 1, true)} µm/m`);
  }
}

// The estimator asks for a reading of the displacement, by a probe.
function nextReading() {
  const asked = page.newest.next_reading;
  document.getElementById("next-reading").hidden = !asked;
  if (!asked) return;
  const field = document.getElementById("next-reading-um"), name = `${asked.axis}_um`;
  // What was typed for one axis is not sent as that of another.
  if (field.name !== name) { field.name = name; field.value = ""; }
  const narrows = `± ${shown(asked.band_um, 1)} µm to ± ${shown(asked.narrowed_um, 1)} µm`;
  write(document.getElementById("next-reading-text"), `A reading of ${asked.axis} would narrow its band from ${narrows}. Asked for at ${clockTime(asked.since_s)}.`);
}

function readings() {
  const body = document.getElementById("readings"), one = page.newest;
  for (const key of page.about.readings) {
    let row = document.getElementById(`reading-${key}`);
    if (!row) {
      row = el("tr");
      row.id = `reading-${key}`;
      const head = el("th", "", unitOf(key) === "um" ? `${bare(key)} (probe)` : bare(key));
      head.scope = "row";
      const residual = el("td", "n residual", "–");
      residual.hidden = !page.about.offers.includes("residuals");
      row.append(head, el("td", "n"), residual, el("td", "used"));
      body.append(row);
    }
    const channel = unitOf(key) ? key.slice(0, -unitOf(key).length - 1) : key;
    const [, unit] = UNITS[unitOf(key)];
    const has = (names) => names.includes(key) || names.includes(channel);
    const value = valueOf(one, "readings", key);
    const state = has(one.distrusted) ? "distrusted" : has(one.missing) ? "missing" : value === null ? "none" : "used";
    row.dataset.state = state;
    write(row.children[1], value === null ? "–" : `${shown(value, 2)}${unit === "1" ? "" : ` ${unit}`}`);
    write(row.children[3], { used: "✓ used", missing: "… missing", distrusted: "✕ distrusted", none: "– none now" }[state]);
  }
}

// What a reading says beyond the estimate: a sensor that lies stands out.
async function residuals() {
  if (document.hidden) return;
  const found = (await ask(`${base}/residuals`)).residuals_K;
  for (const [key, value] of Object.entries(found)) {
    const row = document.getElementById(`reading-${key}`);
    if (row) write(row.querySelector(".residual"), value === null ? "–" : shown(value, 2, true));
  }
}

// Whether the control takes part, and which offset acts in it.
const HANDSHAKES = {
  stands: "✓ stands", disabled: "▲ the control has not enabled offsets",
  "no-heartbeat": "▲ no heartbeat of the control", differs: "▲ the control acknowledges other offsets",
};
async function handshake() {
  if (document.hidden) return;
  const said = await ask(`${base}/handshake`), list = document.getElementById("handshake");
  const facts = [["State", HANDSHAKES[said.state] || said.state], ["Enabled by the control", said.enabled ? "yes" : "no"],
    ["Heartbeat of the control", said.heartbeat === null ? "none" : `${said.heartbeat}, changed ${age(said.heartbeat_age_s ?? NaN)}`]];
  for (const [axis, value] of Object.entries(said.acknowledged_um)) {
    facts.push([`Acknowledged ${axis}`, value === null ? "–" : `${shown(value, 1, true)} µm`]);
  }
  for (const [axis, value] of Object.entries(said.acknowledged_slopes_um_per_m || {})) {
    facts.push([`Acknowledged slope ${axis}`, value === null ? "–" : `${shown(value, 1, true)} µm/m`]);
  }
  const terms = JSON.stringify(facts.map(([term]) => term));
  if (list.dataset.terms !== terms) list.replaceChildren(...facts.flatMap(([term]) => [el("dt", "", term), el("dd")]));
  list.dataset.terms = terms;
  facts.forEach(([, text], k) => write(list.children[2 * k + 1], text));
}

function model() {
  const about = page.about, list = document.getElementById("model");
  const facts = [["Kind", about.kind], ["File", about.model], ["Since", dayTime(about.since_s)]];
  for (const [term, text] of facts) list.append(el("dt", "", term), el("dd", "", text));
  document.getElementById("valid-table").hidden = !about.valid.length;
  for (const one of about.valid) {
    const row = el("tr"), head = el("th", "", one.name.replaceAll("_", " "));
    head.scope = "row";
    row.append(head, el("td", "n", shown(one.low, 1)), el("td", "n", shown(one.high, 1)), el("td", "", one.unit === "1" ? "" : one.unit));
    document.getElementById("valid").append(row);
  }
}

async function events() {
  const found = (await ask(`/api/events?machine=${encodeURIComponent(name)}&most=20`)).events;
  const list = document.getElementById("events"), key = JSON.stringify(found);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...(found.length ? found : [{ text: "none in the last week" }]).map((one) => {
    const item = el("li");
    if (one.time_s) {
      const when = el("time", "", dayTime(one.time_s));
      when.dateTime = one.time;
      item.append(when);
    }
    item.append(el("span", "", one.text));
    return item;
  }));
}

function news(publications) {
  for (const one of publications) {
    page.newest = one;
    if (page.past) append(one);
    for (const chart of page.charts) if (chart.card && chart.card.hidden && chart.used(one)) chart.card.hidden = false;
  }
  status();
  axes();
  nextReading();
  readings();
  ages();
  // A curve of 8 h need not be drawn anew every second.
  const pause = page.span <= 900 ? 900 : page.span <= 3600 ? 1900 : 4900;
  if (Date.now() - page.drawn >= pause) drawAll();
}

// A model that has replaced another has its own axes, readings and ranges: the page begins anew.
async function renew() {
  if (JSON.stringify(await ask(base)) !== JSON.stringify(page.about)) location.reload();
}

function line(state) {
  page.line = state;
  status();
  if (state === "live") {
    renew().catch(() => {});
    load().catch(() => {});
    events().catch(() => {});
  }
}

function spans() {
  const group = document.getElementById("spans");
  for (const [text, seconds] of SPANS) {
    const button = el("button", "", text);
    button.type = "button";
    button.setAttribute("aria-pressed", String(seconds === page.span));
    button.addEventListener("click", () => {
      page.span = seconds;
      for (const one of group.children) one.setAttribute("aria-pressed", String(one === button));
      load().catch(() => {});
    });
    group.append(button);
  }
}

ask(base).then(async (about) => {
  page.about = about;
  spans();
  model();
  page.charts = [{ node: document.getElementById("c-displacement"), curves: displacementCurves }, ...plan(about)];
  page.charts.forEach((chart) => watcher.observe(chart.node));
  listen(`/api/stream?machine=${encodeURIComponent(name)}&every_s=0.5`, news, line);
  document.addEventListener("theme", () => drawAll());
  document.addEventListener("visibilitychange", () => drawAll());
  setInterval(ages, 1000);
  setInterval(() => events().catch(() => {}), 15000);
  setInterval(() => renew().catch(() => {}), 15000);
  // Thinned again from time to time: the curves stay as short as they were.
  setInterval(() => { if (page.line === "live") load().catch(() => {}); }, 300000);
  if (about.offers.includes("residuals")) {
    document.querySelector("th.residual").hidden = false;
    setInterval(() => residuals().catch(() => {}), 5000);
    setTimeout(() => residuals().catch(() => {}), 1000);
  }
  if (about.offers.includes("handshake")) {
    document.getElementById("handshake-card").hidden = false;
    handshake().catch(() => {});
    setInterval(() => handshake().catch(() => {}), 1000);
  }
  if (about.offers.includes("scene")) {
    document.getElementById("scene-card").hidden = false;
    await drawScene(name);
    setInterval(() => drawScene(name), 5000);
  }
});
