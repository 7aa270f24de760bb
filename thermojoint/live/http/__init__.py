"""The service in a browser and for programs: JSON, a stream, the dashboard; TLS and a token."""
