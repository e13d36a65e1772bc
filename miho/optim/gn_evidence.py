def enough(ends, nothing):
    if len(ends) < 5: return False
    best=min(ends); n=len(ends)
    here=sum(e<=best*(1+1e-4)+nothing for e in ends)
    distinct,last=0,-1.0
    for e in sorted(ends):
        if distinct==0 or e>last*(1+1e-4)+nothing:
            distinct+=1; last=e
    return here>=max(5,.25*n) and distinct*(distinct+1)/(n*(n-1))<=0.1
