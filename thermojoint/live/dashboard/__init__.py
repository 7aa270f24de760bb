"""The pages that a browser shows: HTML, styles, scripts; plotly.js from the Python package."""
