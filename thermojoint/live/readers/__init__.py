"""Where readings come from: a pipe of CSV lines, an MQTT broker, an OPC UA server."""
