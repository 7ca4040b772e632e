"""Data under the models: arrays, benefits, matrices, assignments, files."""
