"""Robots' firmware and a world for it, as processes of their own; the bridge never imports them."""
