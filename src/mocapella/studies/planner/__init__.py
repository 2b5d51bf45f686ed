"""The planner: where sensors should stand in a room, so that they see its floor and measure people well.

    room = read_room(path)                        # walls, obstacles, area, people, sensors
    views = RoomViews(room)                       # all places for sensors, and what each of them sees
    found = best_placement(views, sensors=3)      # the poses of least cost
    score = views.score(found)                    # coverage and expected error, by cell

docs/planner.md states the cost function and how it was compared with the simulated room.
"""
