"""Recording: devices, the recorder, its logs, and what stands in for a device."""
