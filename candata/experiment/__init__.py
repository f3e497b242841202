"""Experiments: a file of data, models and regimes becomes a graph of cells, each kept, and a table of their scores."""
