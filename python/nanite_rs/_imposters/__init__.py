"""Imposters: the map of directions, how views are baked, mixed and filed."""
