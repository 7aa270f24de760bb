"""Readers of measurements: CSV lines, MQTT, OPC UA."""
