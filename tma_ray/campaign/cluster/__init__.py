"""Connection to Ray: its nodes, a watched head, shipping of plug-ins."""
