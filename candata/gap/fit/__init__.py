"""What is searched: candidates, their signatures and responses, fits and the rule that compares them."""
