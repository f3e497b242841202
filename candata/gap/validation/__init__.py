"""Whether names hold and how far the gap closes, on episodes that took no part in choosing them."""
