"""Connection to Ray: the nodes, the watched head and the shipping of plug-ins."""
