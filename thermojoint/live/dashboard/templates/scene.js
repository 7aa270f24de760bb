"use strict";
// The machine in 3-D: its surface by temperature, its joints by pressure. Shapes are sent once.

const SCALE = [[0, "#2b3a8c"], [0.25, "#2f8fbf"], [0.5, "#7fc97f"], [0.75, "#f2b134"], [1, "#c0262d"]];
const scene = { shape: null, busy: false };

function sceneLayout(part) {
  const hidden = { visible: false, showbackground: false };
  return {
    autosize: true,
    margin: { l: 0, r: 0, t: 0, b: 0 },
    paper_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", size: 13, color: colour("--muted") },
    uirevision: "kept",
    scene: {
      xaxis: hidden, yaxis: hidden, zaxis: hidden, aspectmode: "data", dragmode: "turntable",
      camera: { eye: part.eye },
    },
  };
}

function mesh(part, values) {
  const [x, y, z] = part.points_m, [i, j, k] = part.triangles;
  return {
    type: "mesh3d", x, y, z, i, j, k, intensity: values, intensitymode: part.per,
    colorscale: SCALE, flatshading: false, hovertemplate: "%{intensity:.3~g}<extra></extra>",
    lighting: { ambient: 0.75, diffuse: 0.4, specular: 0.05 },
    colorbar: { thickness: 12, len: 0.7, x: 1, tickfont: { color: colour("--muted") } },
  };
}

async function drawScene(machine) {
  if (scene.busy || document.hidden) return;
  scene.busy = true;
  try {
    const path = `/api/machines/${encodeURIComponent(machine)}`;
    const first = scene.shape === null;
    if (first) scene.shape = await ask(`${path}/scene`);
    const fields = await ask(`${path}/fields`);
    for (const [id, part, values] of [
      ["c-temperature", scene.shape.surface, fields.temperature_K],
      ["c-pressure", scene.shape.joints, fields.pressure_MPa],
    ]) {
      const node = document.getElementById(id);
      if (first) await Plotly.newPlot(node, [mesh(part, values)], sceneLayout(part), CONFIG);
      else await Plotly.restyle(node, { intensity: [values] }, [0]);
    }
  } catch { /* before the first sample there is nothing to draw; it is asked again */ }
  scene.busy = false;
}
