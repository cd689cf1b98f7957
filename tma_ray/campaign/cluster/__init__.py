"""Connection to Ray: nodes, monitored head, and shipping of plug-ins."""
