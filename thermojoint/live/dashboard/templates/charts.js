"use strict";
// Curves over time. Every chart is made once; what changes is its data.

const LINES = ["--line-1", "--line-2", "--line-3", "--line-4", "--line-5", "--line-6"];
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function faint(hex) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  return `rgba(${r},${g},${b},0.2)`;
}

// Plotly has no time zones: it is given the local time as if it were UTC.
function localTime(seconds) {
  const ms = 1000 * seconds;
  return ms - 60000 * new Date(ms).getTimezoneOffset();
}

function layoutOf(from, to, revision) {
  const grid = colour("--grid"), text = colour("--muted");
  const axis = { gridcolor: grid, linecolor: grid, zerolinecolor: colour("--zero"), tickfont: { color: text }, fixedrange: true };
  return {
    autosize: true,
    datarevision: revision,
    margin: { l: 48, r: 8, t: 30, b: 36 },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", size: 13, color: text },
    showlegend: true,
    legend: { orientation: "h", x: 0, y: 1.01, yanchor: "bottom", traceorder: "normal", font: { color: colour("--text") } },
    xaxis: { ...axis, type: "date", range: [localTime(from), localTime(to)], nticks: 5 },
    yaxis: { ...axis, nticks: 6, automargin: true },
    hovermode: "x unified",
    hoverlabel: { bgcolor: colour("--card"), bordercolor: colour("--grid"), font: { color: colour("--text") } },
  };
}

const CONFIG = { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: false };

// curves: [{ name, values, band, mode }], each as long as times.
function traces(times, curves) {
  const x = times.map(localTime);
  const found = [];
  curves.forEach((curve, k) => {
    const line = colour(LINES[k % LINES.length]);
    if (curve.band) {
      const edge = (sign) => curve.values.map((value, n) =>
        value === null || curve.band[n] === null ? null : value + sign * curve.band[n]);
      const shared = { x, mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false, type: "scatter" };
      found.push({ ...shared, y: edge(-1) });
      found.push({ ...shared, y: edge(1), fill: "tonexty", fillcolor: faint(line) });
    }
    found.push({
      x, y: curve.values, name: curve.name, type: "scatter", mode: curve.mode || "lines",
      line: { color: line, width: 2, dash: DASHES[k % DASHES.length] },
      hovertemplate: "%{y:.4~g}",
    });
  });
  return found;
}

function draw(node, times, curves, from, to, revision) {
  return Plotly.react(node, traces(times, curves), layoutOf(from, to, revision), CONFIG);
}
