"""BIT*, batch informed trees."""
