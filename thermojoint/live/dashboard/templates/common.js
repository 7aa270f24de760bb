"use strict";
// What both pages share: numbers and words, the stream and the state of its line.

const SIGNS = { good: "✓", uncertain: "▲", bad: "✕", none: "…" };

//: Silence of the stream after which the page says so; a sign of life comes every 3 s.
const SILENCE_MS = 9000;

const REASONS = {
  "beyond-time": "running longer than calibrated",
  "beyond-heat": "more heat than calibrated",
  "beyond-temperature": "a temperature outside the calibrated range",
  "beyond-displacement": "a displacement outside the calibrated range",
  "reading-missing": "no reading",
  "readings-lost": "too little is read",
  "unsettled": "settling after a start or a gap",
  "sensor-distrusted": "left out, contradicts the rest",
  "reading-refused": "a measured displacement was refused",
  "silent": "no samples arrive",
  "no-sample": "no sample yet",
  "refused": "the estimator refused the sample",
};

function el(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

// Writes only what is new, so that a screen reader hears only what is new.
function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function shown(value, digits = 1, signed = false) {
  if (value === null || value === undefined) return "–";
  const text = Math.abs(value).toFixed(digits);
  const zero = Number(text) === 0;
  if (value < 0 && !zero) return `−${text}`;
  return signed && !zero ? `+${text}` : text;
}

// A source may be a minute ahead of the service; a sample further ahead is from before the clock was set back.
function age(seconds) {
  if (!(seconds >= -60)) return "–";
  if (seconds < 1.5) return "now";
  if (seconds < 120) return `${Math.round(seconds)} s ago`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min ago`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h ago`;
  return `${Math.round(seconds / 86400)} days ago`;
}

// The same everywhere, as 3/4 is two days: 2026-11-21 08:05:00.
function dayTime(seconds) { return new Date(1000 * seconds).toLocaleString("sv-SE"); }
function clockTime(seconds) { return new Date(1000 * seconds).toLocaleTimeString("sv-SE"); }

function sentences(status) {
  if (!status || status === "ok") return "";
  return status.split(" ").map((word) => {
    const [reason, channels] = word.split(":");
    const text = REASONS[reason] || reason.replaceAll("-", " ");
    return channels ? `${channels.replaceAll(",", ", ")}: ${text}` : text;
  }).join("; ");
}

async function ask(path) {
  const answer = await fetch(path, { headers: { accept: "application/json" } });
  if (answer.status === 401) location.assign("/login");
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error || String(answer.status));
  return body;
}

// Seconds since 1970 by the service's clock: that of a panel on the shop floor may be anything.
const clock = { offset: 0, now() { return Date.now() / 1000 + this.offset; } };

// Calls news(publications) for what comes and line(state) with "live", "silent" or "lost".
function listen(path, news, line) {
  let heard = 0, source = null, again = 1000, state = "opening";

  function tell(now) {
    if (now === state) return;
    state = now;
    const pill = document.getElementById("line");
    pill.dataset.state = now;
    write(pill, { live: "live", lost: "no connection", opening: "connecting" }[now]);
    document.body.classList.toggle("stale", now === "lost");
    line(now);
  }

  function open() {
    source = new EventSource(path);
    source.addEventListener("news", (event) => {
      const body = JSON.parse(event.data);
      clock.offset = body.now_s - Date.now() / 1000;
      heard = Date.now();
      again = 1000;
      tell("live");
      if (body.publications.length) news(body.publications);
    });
    source.addEventListener("error", () => {
      tell("lost");
      if (source.readyState !== EventSource.CLOSED) return;
      // The service said no, and a browser does not ask twice by itself.
      setTimeout(() => { ask("/api/machines").catch(() => {}).finally(open); }, again);
      again = Math.min(2 * again, 30000);
    });
  }

  setInterval(() => {
    if (state !== "live" || Date.now() - heard <= SILENCE_MS) return;
    tell("lost");
    source.close();
    open();
  }, 1000);
  open();
}
