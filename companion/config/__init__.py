"""Every setting, as typed models; one YAML file describes one vehicle."""
