; The Home Assistant Benchmark as plain STRIPS: which skill when. Actions are named like the skills.
;
; Doors. "Not in a closed container" is a negation over what holds the target; plain STRIPS has none. So every target
; is in exactly one holder, every holder is open or closed, and what stands on tables and counters is in the holder
; in_the_open, which is always open.
;
; Where the robot is. It stands at one landmark, the last one it went to. A drawer is pulled towards the robot: with the
; drawer open, the robot stands at the target that lies in it. The fridge's door swings through where the robot stands:
; whoever moves it ends up elsewhere. That is why SetTable picks the bowl without navigating, but not the apple.
;
; Order. Only the target whose turn it is may be handled. The turn goes to the next target when this one is at its goal
; and never comes back, so a container the task wants closed is closed before it goes.

(define (domain home)
  (:requirements :strips :typing)

  (:types
    landmark - object
    target goal holder - landmark
    drawer fridge - holder)

  (:constants
    elsewhere - landmark
    in_the_open - holder)

  (:predicates
    (turn ?t - target)
    (next ?t ?u - target)                     ; after ?t comes ?u
    (concerns ?l - landmark ?t - target)      ; handling ?t may lead to ?l: itself, its goal, its containers
    (goal_of ?g - goal ?t - target ?h - holder) ; ?t belongs at ?g, which is in ?h
    (robot_at ?l - landmark)
    (in ?t - target ?h - holder)
    (open ?h - holder)
    (closed ?h - holder)
    (hand_empty)
    (holding ?t - target)
    (at_goal ?t - target))

  (:action navigate
    :parameters (?t - target ?here ?there - landmark)
    :precondition (and (turn ?t) (robot_at ?here) (concerns ?there ?t))
    :effect (and (not (robot_at ?here)) (robot_at ?there)))

  (:action pick
    :parameters (?t - target ?h - holder)
    :precondition (and (turn ?t) (robot_at ?t) (in ?t ?h) (open ?h) (hand_empty))
    :effect (and (not (hand_empty)) (holding ?t) (not (in ?t ?h)) (not (at_goal ?t))))

  (:action place
    :parameters (?t - target ?g - goal ?h - holder)
    :precondition (and (turn ?t) (robot_at ?g) (holding ?t) (goal_of ?g ?t ?h) (open ?h))
    :effect (and (not (holding ?t)) (hand_empty) (in ?t ?h) (at_goal ?t)))

  (:action open_drawer
    :parameters (?t - target ?d - drawer)
    :precondition (and (turn ?t) (robot_at ?d) (in ?t ?d) (closed ?d) (hand_empty))
    :effect (and (not (closed ?d)) (open ?d) (not (robot_at ?d)) (robot_at ?t)))

  (:action close_drawer
    :parameters (?t - target ?d - drawer)
    :precondition (and (turn ?t) (robot_at ?d) (concerns ?d ?t) (open ?d) (hand_empty))
    :effect (and (not (open ?d)) (closed ?d)))

  (:action open_fridge
    :parameters (?t - target ?f - fridge)
    :precondition (and (turn ?t) (robot_at ?f) (concerns ?f ?t) (closed ?f) (hand_empty))
    :effect (and (not (closed ?f)) (open ?f) (not (robot_at ?f)) (robot_at elsewhere)))

  (:action close_fridge
    :parameters (?t - target ?f - fridge)
    :precondition (and (turn ?t) (robot_at ?f) (concerns ?f ?t) (open ?f) (hand_empty))
    :effect (and (not (open ?f)) (closed ?f) (not (robot_at ?f)) (robot_at elsewhere)))

  (:action next_target                        ; no skill: the benchmark's counter of targets
    :parameters (?t ?u - target)
    :precondition (and (turn ?t) (next ?t ?u) (at_goal ?t) (hand_empty))
    :effect (and (not (turn ?t)) (turn ?u))))
