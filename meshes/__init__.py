"""Structures: labelled meshes with bodies, surfaces, joints and probes, and their files."""
