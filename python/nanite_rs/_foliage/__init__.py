"""Cards of leaves as geometry.

`roles` finds leaves, `masks` traces what images show, `cards` puts it on their surface, `convert` goes through it all.
"""
