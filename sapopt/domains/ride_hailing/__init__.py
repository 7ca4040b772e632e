"""Ride-hailing: drivers and requests in a city, made up or read from public trip tables (thesis, 7.1.2)."""

from sapopt.domains.ride_hailing.city import City, random_city
from sapopt.domains.ride_hailing.tables import city_from_trips
from sapopt.domains.ride_hailing.trips import Trips, read_trips, read_zones
from sapopt.domains.ride_hailing.waiting import WaitingCity, random_waiting_city

__all__ = [
    "City",
    "Trips",
    "WaitingCity",
    "city_from_trips",
    "random_city",
    "random_waiting_city",
    "read_trips",
    "read_zones",
]
