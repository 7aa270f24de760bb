"""Files of settings (TOML): what a section is made of, and what is said where one is wrong."""
