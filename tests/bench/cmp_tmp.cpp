#include <cstdio>
#include <cstdlib>
#include "services/cli/scene_file.hpp"
#include "services/simulation/scene_messages.hpp"
#include "services/simulation/simulation.hpp"
using namespace pleat;
int main(int argc,char**argv){
  auto run=[&](const char* tol,int steps){ setenv("TOL",tol,1);
    auto scene=simulation::scene_from_message(cli::read_scene_file("deploy/scenes/draping.json")); scene.frames=41; scene.threads=1; if(steps) scene.steps_per_frame=steps;
    simulation::Simulation s(scene,simulation::Mode::kTrackedFine); std::vector<Positions> out; std::uint64_t its=0; double feat=0;
    for(int k=0;k<41;++k){auto f=s.next_frame(); out.push_back(f.fine->positions); its+=f.report.solver_iterations; double d=0; for(size_t v=0;v<s.feature_vertices().size();++v) d+=(f.fine->positions.row(s.feature_vertices()[v])-f.coarse.positions.row(v)).norm(); feat+=d/s.feature_vertices().size();}
    printf("tol %s steps %d: its/frame %.1f feature distance %.3f mm\n",tol,steps,its/40.0,1e3*feat/41); return out;};
  auto ref=run("1e-5",0);
  for(const char* t:{"1e-3","3e-3","1e-2","3e-2"}){auto o=run(t,0); for(int k:{10,20,30,40}) printf("  frame %d rms %.3f mm\n",k,1e3*std::sqrt((o[k]-ref[k]).rowwise().squaredNorm().mean()));}
}
