"use strict";
// Light or dark as the system says, or as somebody has chosen here.
(() => {
  const root = document.documentElement;
  const words = { auto: ["Auto", "as the system"], light: ["Light", "light"], dark: ["Dark", "dark"] };
  const next = { auto: "light", light: "dark", dark: "auto" };
  let chosen = "auto";
  try { chosen = localStorage.getItem("theme") || "auto"; } catch { /* not kept, then */ }
  if (!(chosen in words)) chosen = "auto";

  function show() {
    if (chosen === "auto") root.removeAttribute("data-theme");
    else root.setAttribute("data-theme", chosen);
    const button = document.getElementById("theme");
    if (button) {
      button.textContent = words[chosen][0];
      button.setAttribute("aria-label", `Colours: ${words[chosen][1]}`);
    }
    document.dispatchEvent(new Event("theme"));
  }

  show();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
  document.addEventListener("DOMContentLoaded", () => {
    show();
    document.getElementById("theme").addEventListener("click", () => {
      chosen = next[chosen];
      try { localStorage.setItem("theme", chosen); } catch { /* not kept, then */ }
      show();
    });
  });
})();
