"""Where publications go: nodes of an OPC UA server, topics of an MQTT broker."""
