"""From recordings to filtered signals on a uniform grid."""
