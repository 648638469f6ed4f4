"""Interim: a solve of a tick in C, with a memory per layout."""
import ctypes as ct
import dataclasses
from ..ilqr import STATUS, Outer, SolverMemory
from ..ilqr.native.library import library_for
from .numpy_tick import Solved


class Pool:
    def __init__(self): self.m={}; self.lib=None
    def __call__(self, problem, start, options, shooting):
        key=tuple((id(p.mode),p.num_stages,id(p.transition)) for p in problem.phases)
        if key not in self.m:
            lib,_=library_for(problem)
            o=options
            self.m[key]=SolverMemory(problem,lib,dataclasses.replace(o,max_iterations=300))
        m=self.m[key]; m.set_numbers(problem)
        for i,(x,u) in enumerate(zip(start.states,start.controls)):
            m.trial(i,'x')[:]=x.ravel(); m.trial(i,'u')[:]=u.ravel()
        outer=Outer(problem,options)
        for name in ("relaxation", "shift", "multiplier", "penalty"):
            m.write_rows(name,"stage",[getattr(d,name) for d in outer.duals])
            m.write_rows(name,"end",[getattr(d,f"end_{name}") for d in outer.duals])
        m.c.weight,m.c.cancel,m.c.num_records=outer.weight,0,0
        m.c.options.max_iterations=options.max_iterations
        r=m.library.piaffe_solve(ct.byref(m.c),0)
        sweeps=m.policy(); c=m.c
        xs=[m.accepted(i,'x').reshape(p.num_stages+1,-1).copy() for i,p in enumerate(problem.phases)]
        us=[m.accepted(i,'u').reshape(p.num_stages,-1).copy() for i,p in enumerate(problem.phases)]
        return Solved(STATUS[r],xs,us,sweeps,c.num_records,c.cost,c.max_defect,c.max_equality,c.max_inequality)
