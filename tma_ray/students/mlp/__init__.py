"""The multilayer perceptron of all students' networks. Importing this package imports no torch."""
