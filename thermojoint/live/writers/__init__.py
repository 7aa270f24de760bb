"""Writers of publications: OPC UA nodes, MQTT topics."""
