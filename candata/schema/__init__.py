"""Records: channels, episodes, manifests, scenes, effects, reports."""
