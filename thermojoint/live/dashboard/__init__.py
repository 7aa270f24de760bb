"""The pages for a browser: HTML, styles, scripts; plotly.js from the Python package."""
