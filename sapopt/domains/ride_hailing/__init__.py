"""Ride-hailing: drivers and requests in a city, made up or read from public trip tables (thesis, 7.1.2)."""

from sapopt.domains.ride_hailing.city import City, random_city
from sapopt.domains.ride_hailing.tables import city_from_trips
from sapopt.domains.ride_hailing.trips import Trips, read_trips, read_zones

__all__ = ["City", "Trips", "city_from_trips", "random_city", "read_trips", "read_zones"]
