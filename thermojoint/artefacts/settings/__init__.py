"""Files of settings (TOML): sections, and messages about mistakes in them."""
