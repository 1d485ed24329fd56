"""URDF with identified inertias."""
