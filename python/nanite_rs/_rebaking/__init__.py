"""Rebaking: images for levels that were made without texture coordinates, sampled from the source."""
