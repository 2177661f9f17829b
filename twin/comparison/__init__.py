"""Ways of coordinating, compared on the same paths and draws."""
