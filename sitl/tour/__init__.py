"""A good inspection tour through a known mine: what explorations are compared with."""
