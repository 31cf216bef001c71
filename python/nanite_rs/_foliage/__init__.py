"""Cards of leaves as geometry.

`roles` finds leaves, `masks` traces what images show, `cards` puts it on their surface, `convert` does it all.
"""
